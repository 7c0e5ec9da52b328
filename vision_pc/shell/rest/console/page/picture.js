// The live picture: canvases for both eyes and the loupe, and what was detected as drawings over them.

import { byId, millimetres, write } from './dom.js';
import { aimed } from './targets.js';

const SVG = 'http://www.w3.org/2000/svg';
const STALE_MS = 500;
const LOUPE = { mm: 30, least: 24, most: 160 }; // what it is wide, and its limits in pixels of the left eye
let newest = null; // the left eye's bitmap
let drawn = null; // the newest overlay
let tolerance = 5; // mm
let arrived = 0;
let age = 0; // of the newest picture when it arrived, ms since its capture
let fastest = []; // [when, delay] of deliveries: the clocks of page and vision PC differ by an unknown constant

/** Shows one message of the stream. */
export async function showPicture(message) {
  const [left, right] = await Promise.all([createImageBitmap(message.left), message.right.size ? createImageBitmap(message.right) : null]);
  paint(byId('left'), left);
  if (right) paint(byId('right'), right);
  right?.close();
  newest?.close();
  newest = left;
  arrived = performance.now();
  age = message.ageMs + late(message.encodedMs);
  paintLoupe();
  write(byId('frame-told'), `frame ${message.frame} · ${Math.round(age)} ms old`);
  byId('left').dataset.frame = message.frame;
}

/** How much longer this delivery took than the fastest of the last minute, ms. */
function late(encodedMs) {
  const delay = arrived - encodedMs;
  fastest = fastest.filter(([when, other]) => arrived - when < 60_000 && other < delay);
  fastest.push([arrived, delay]);
  return delay - fastest[0][1];
}

/** Says over the picture why there is none that was captured lately. */
export function pictureAge(trouble) {
  const old = age + performance.now() - arrived;
  const stale = !arrived || old > STALE_MS;
  byId('no-picture').hidden = !stale;
  if (!stale) return;
  const seconds = `${(old / 1000).toFixed(old < 10_000 ? 1 : 0)} s old`;
  if (arrived) write(byId('frame-told'), `frame ${byId('left').dataset.frame} · ${seconds}`);
  write(byId('no-picture'), arrived ? `▲ This picture is ${seconds}. ${trouble ?? ''}` : trouble ?? 'Waiting for pictures');
}

function paint(canvas, bitmap) {
  if (canvas.width !== bitmap.width) { canvas.width = bitmap.width; canvas.height = bitmap.height; }
  canvas.getContext('2d').drawImage(bitmap, 0, 0);
}

/** Where the loupe looks: the aim, else the tool, else the middle. */
function centre() {
  const [width, height] = drawn?.size ?? [1280, 720];
  return drawn?.aim?.at ?? drawn?.tool?.origin ?? [width / 2, height / 2];
}

/** Width and height of what the loupe shows, px of the left eye: a few tolerances where the aim is known. */
function loupeSize() {
  const square = drawn?.aim?.square;
  const px = square ? (Math.hypot(square[1][0] - square[0][0], square[1][1] - square[0][1]) * LOUPE.mm) / (2 * tolerance) : LOUPE.most;
  const width = Math.min(Math.max(px, LOUPE.least), LOUPE.most);
  write(byId('loupe-told'), square ? `${((width / px) * LOUPE.mm).toFixed(0)} mm wide` : 'the middle');
  return [width, (width * 9) / 16];
}

function paintLoupe() {
  const canvas = byId('loupe');
  const [x, y] = centre();
  const [w, h] = loupeSize();
  const context = canvas.getContext('2d');
  context.imageSmoothingEnabled = false;
  context.fillRect(0, 0, canvas.width, canvas.height);
  if (newest) context.drawImage(newest, x - w / 2, y - h / 2, w, h, 0, 0, canvas.width, canvas.height);
}

/** Draws what was detected. */
export function showOverlay(overlay, toleranceMm) {
  tolerance = toleranceMm ?? tolerance;
  if (overlay && drawn && overlay.frame_id === drawn.frame_id && JSON.stringify(overlay.aim) === JSON.stringify(drawn.aim)) return;
  drawn = overlay;
  const svg = byId('overlay');
  svg.replaceChildren();
  byId('loupe-overlay').replaceChildren();
  write(byId('seen-told'), words(overlay));
  if (!overlay) return;
  svg.setAttribute('viewBox', `0 0 ${overlay.size[0]} ${overlay.size[1]}`);
  shapes(overlay, svg, 1);
  labels(overlay, svg);
  const [x, y] = centre();
  const loupe = byId('loupe-overlay');
  const [w, h] = loupeSize();
  loupe.setAttribute('viewBox', `${x - w / 2} ${y - h / 2} ${w} ${h}`);
  shapes({ ...overlay, markers: [] }, loupe, w / 320);
}

function shapes(overlay, svg, scale) {
  const layers = Object.fromEntries([...document.querySelectorAll('[data-layer]')].map((box) => [box.dataset.layer, box.checked]));
  const line = (d, kind, width) => {
    svg.append(path(d, 'casing', (width + 2.4) * scale), path(d, kind, width * scale));
  };
  if (layers.markers) for (const marker of overlay.markers) line(closed(marker.corners), `marker ${marker.role}`, 2);
  if (layers.axes) {
    for (const axes of [overlay.tool, overlay.object]) {
      if (!axes) continue;
      for (const axis of ['x', 'y', 'z']) line(open([axes.origin, axes[axis]]), `ax-${axis}`, 2);
    }
  }
  const aim = overlay.aim;
  if (aim?.at && layers.error) {
    if (aim.square) line(closed(aim.square), 'square', 2);
    if (overlay.tool) line(open([overlay.tool.origin, aim.at]), 'arrow', 2.4);
    line(cross(aim.at, 7 * Math.max(scale, 0.4)), 'aim', 1.8);
  }
  if (aim?.ellipse && layers.told) line(closed(aim.ellipse), 'told', 2.4);
}

function labels(overlay, svg) {
  for (const marker of overlay.markers) {
    const xs = marker.corners.map((corner) => corner[0]);
    const ys = marker.corners.map((corner) => corner[1]);
    text(svg, marker.role === 'tool' ? 'tool' : `object ${marker.id}`, Math.min(...xs), Math.max(...ys) + 20);
  }
}

/** What is seen, in one line. */
function words(overlay) {
  if (!overlay) return 'nothing measured yet';
  const of = (name, axes) => (axes ? `${name} seen` : `▲ ${name} ${(overlay.missing[name] ?? 'not_seen').replaceAll('_', ' ')}`);
  const residual = Math.max(...overlay.markers.map((marker) => marker.residual_px), 0);
  const error = overlay.error_mm ? ` · error ${millimetres(overlay.error_mm, 1)}` : '';
  const target = aimed();
  const object = target?.known === 'lost' ? '▲ target lost' : target?.known === 'carried' && !overlay.object ? 'target carried by odometry'
    : of(target ? 'target' : 'object', overlay.object);
  return `${of('tool', overlay.tool)} · ${object} · residual ${residual.toFixed(2)} px${error}`;
}

const open = (points) => `M${points.map((point) => point.join(' ')).join('L')}`;
const closed = (points) => `${open(points)}Z`;
const cross = ([x, y], r) => `M${x - r} ${y}H${x + r}M${x} ${y - r}V${y + r}`;

function path(d, kind, width) {
  const element = document.createElementNS(SVG, 'path');
  element.setAttribute('d', d);
  element.setAttribute('class', kind);
  element.setAttribute('stroke-width', width);
  return element;
}

function text(svg, words_, x, y) {
  const element = document.createElementNS(SVG, 'text');
  element.setAttribute('x', x);
  element.setAttribute('y', y);
  element.textContent = words_;
  svg.append(element);
}

/** Draws anew when a layer is switched. */
export function installLayers() {
  byId('layers').addEventListener('change', () => { const last = drawn; drawn = null; showOverlay(last); });
}

