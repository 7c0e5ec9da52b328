// The arm from the side, in the upright plane through its pillar and its tool, with its direction from above.

import { byId } from './dom.js';
import { truth } from './emulator.js';
import { still } from './scene.js';

const SVG = 'http://www.w3.org/2000/svg';
const [WIDTH, HEIGHT, EDGE] = [310, 268, 14];
const MOST = 600; // points of the driven path
const NEXT_M = 0.004;
const path = [];
let last = [];
let lastTruth = [];
let box = null; // [least r, least z, pixels a metre], grown as the arm needs it

/** Draws a snapshot, where the arm has moved. */
export function showSideView(shot) {
  const points = shot.skeleton;
  const really = truth() ?? [];
  if (!points.length || (still(points, last) && still(really, lastTruth) && byId('side-view').childElementCount)) return;
  [last, lastTruth] = [points, really];
  const tool = points.at(-1);
  const bearing = Math.atan2(tool[1], tool[0]);
  const seen = (arm) => [[0, 0], [0, arm[1][2]], ...arm.slice(1).map(([x, y, z]) => [x * Math.cos(bearing) + y * Math.sin(bearing), z])];
  const flat = seen(points);
  const tip = flat.at(-1);
  const before = path.at(-1);
  if (!before || Math.hypot(before[0] - tip[0], before[1] - tip[1]) > NEXT_M) path.push(tip);
  if (path.length > MOST) path.shift();
  fit([...flat, ...path]);
  const line = (way) => `M${way.map(([r, z]) => at(r, z).join(' ')).join('L')}`;
  byId('side-view').replaceChildren(
    ...grid(),
    shape('path', { class: 'way', d: line(path) }),
    ...flat.slice(1).map((end, index) => shape('path', { class: 'link', d: line([flat[index], end]), 'stroke-width': Math.max(13 - 2 * index, 4) })),
    ...flat.slice(1).map((joint, index) => shape('circle', { class: 'pivot', cx: at(...joint)[0], cy: at(...joint)[1], r: Math.max(6.5 - index, 3) })),
    ...(really.length ? [shape('path', { class: 'ghost', d: line(seen(really)) })] : []),
    ...compass(bearing),
  );
}

/** Has all of `points` in the picture; it only ever zooms out, so that a moving arm is seen to move. */
function fit(points) {
  const [rs, zs] = [points.map((p) => p[0]), points.map((p) => p[1])];
  const [left, bottom, right, top] = [Math.min(...rs) - 0.4, Math.min(...zs, 0) - 0.2, Math.max(...rs) + 0.3, Math.max(...zs) + 0.3];
  const inside = box && at(left, bottom)[0] >= 0 && at(right, top)[0] <= WIDTH && at(right, top)[1] >= 0 && at(left, bottom)[1] <= HEIGHT;
  if (inside) return;
  box = [left - 0.2, bottom, Math.min((WIDTH - EDGE) / (right - left + 0.4), (HEIGHT - EDGE) / (top - bottom + 0.4))];
}

const at = (r, z) => [EDGE / 2 + (r - box[0]) * box[2], HEIGHT - EDGE / 2 - (z - box[1]) * box[2]];

/** Lines a metre apart, with the ground. */
function grid() {
  const lines = [];
  for (let r = Math.ceil(box[0]); at(r, 0)[0] < WIDTH; r++) lines.push(shape('path', { class: 'metre', d: `M${at(r, 0)[0]} 0V${HEIGHT}` }), label(`${r} m`, at(r, 0)[0] + 3, HEIGHT - 3));
  for (let z = Math.ceil(box[1]); at(0, z)[1] > 0; z++) lines.push(shape('path', { class: z ? 'metre' : 'ground', d: `M0 ${at(0, z)[1]}H${WIDTH}` }));
  return lines;
}

/** Where the arm points, from above: forward is up. */
function compass(bearing) {
  const [x, y, r] = [WIDTH - 26, 28, 17];
  const tip = [x - r * Math.sin(bearing), y - r * Math.cos(bearing)];
  return [
    shape('circle', { class: 'dial', cx: x, cy: y, r }),
    shape('path', { class: 'metre', d: `M${x} ${y - r}v-5` }),
    shape('path', { class: 'needle', d: `M${x} ${y}L${tip[0]} ${tip[1]}` }),
    label(`${Math.round((bearing * 180) / Math.PI) || 0}°`.replace('-', '−'), x - 10, y + r + 13),
  ];
}

function shape(tag, attributes) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

function label(words, x, y) {
  const element = shape('text', { x, y });
  element.textContent = words;
  return element;
}
