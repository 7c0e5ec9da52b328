// Error at the target: the looked error with its uncertainty, the told ellipse, tolerance and verdict.

import { ago, byId, make, signed, write } from './dom.js';

const SVG = 'http://www.w3.org/2000/svg';
const SHOWN = 2; // tolerances from the middle to the edge
const K95 = 2.4477; // half axis of the 95 % ellipse in standard deviations, normal in two dimensions

/** Shows the newest look and what was told before it. `now`: vision's own time in ns, by the stream. */
export function showVerdict(look, told, ageS) {
  write(byId('look-age'), look ? `looked ${ago(ageS)}` : 'no look yet');
  bars(look);
  plot(look, told);
  words(look, told);
}

function bars(look) {
  const place = byId('errors');
  if (!place.children.length) {
    for (const axis of 'xyz') {
      place.append(make('div', { class: 'err' }, make('span', {}, axis), make('div', { class: 'track', 'aria-hidden': 'true' }, make('i'), make('s'), make('b')), make('span', { class: 'num live-value' }, '–')));
    }
  }
  [...'xyz'].forEach((axis, index) => {
    const row = place.children[index];
    const track = row.children[1];
    if (!look) { write(row.children[2], '–'); return; }
    const [mm, std, tolerance] = [look.error_mm[axis], look.std_mm[axis], look.tolerance_mm];
    const at = (value) => `${Math.min(Math.max(50 + (50 * value) / (SHOWN * tolerance), 0), 100)}%`;
    const [bar, whisker, band] = [track.querySelector('b'), track.querySelector('s'), track.querySelector('i')];
    Object.assign(bar.style, { left: at(Math.min(0, mm)), right: `calc(100% - ${at(Math.max(0, mm))})`, minWidth: '2px' });
    Object.assign(whisker.style, { left: at(mm - 2 * std), right: `calc(100% - ${at(mm + 2 * std)})` });
    band.hidden = axis === 'z'; // the tolerance is of x and y
    track.classList.toggle('out', axis !== 'z' && Math.abs(mm) > tolerance);
    write(row.children[2], `${signed(mm, Math.abs(mm) < 10 ? 2 : Math.abs(mm) < 100 ? 1 : 0)} mm`);
  });
}

function shape(tag, attributes) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

/** Tolerance square, told ellipse and looked error in x and y, seen as the camera sees them (y down). */
function plot(look, told) {
  const svg = byId('target');
  const tolerance = look?.tolerance_mm ?? 5;
  const px = 100 / (SHOWN * tolerance);
  const side = tolerance * px;
  svg.replaceChildren(
    shape('rect', { class: 'ground', x: -100, y: -100, width: 200, height: 200, rx: 3 }),
    shape('rect', { class: 'inside', x: -side, y: -side, width: 2 * side, height: 2 * side }),
    shape('path', { class: 'cross', d: 'M-100 0H100M0 -100V100' }),
  );
  if (told) {
    const { major, minor, angle_deg: angle } = told.ellipse_95_mm;
    svg.append(shape('ellipse', { class: 'told', rx: major * px, ry: minor * px, transform: `translate(${told.mean_mm.x * px} ${told.mean_mm.y * px}) rotate(${angle})` }));
  }
  const text = shape('text', { x: -96, y: 94 });
  text.textContent = `±${tolerance} mm`;
  if (look) {
    const [x, y] = [look.error_mm.x * px, look.error_mm.y * px];
    const far = Math.max(Math.abs(x), Math.abs(y)) > 100;
    if (far) {
      const scale = 94 / Math.max(Math.abs(x), Math.abs(y));
      svg.append(shape('path', { class: 'looked', d: `M${x * scale * 0.8} ${y * scale * 0.8}L${x * scale} ${y * scale}` }), shape('circle', { class: 'spot', cx: x * scale, cy: y * scale, r: 4 }));
      text.textContent = `±${tolerance} mm, error beyond`;
    } else {
      svg.append(shape('ellipse', { class: 'looked', cx: x, cy: y, rx: Math.max(K95 * look.std_mm.x * px, 1), ry: Math.max(K95 * look.std_mm.y * px, 1) }), shape('circle', { class: 'spot', cx: x, cy: y, r: 3 }));
    }
  }
  svg.append(text);
}

function words(look, told) {
  const place = byId('verdict-told');
  const before = told ? ` Predicted before the drive: ${percent(told.inside_probability)} inside; 95 % of ends within ±${told.ellipse_95_mm.major.toFixed(1)} × ±${told.ellipse_95_mm.minor.toFixed(1)} mm.` : '';
  const text = look ? `${look.verdict === 'inside' ? 'Inside' : 'Outside'} ±${look.tolerance_mm} mm, ${look.certain ? 'and its 95 % interval is, too' : 'but its 95 % interval crosses the limit'}.` : 'Look, or run the procedure, to measure the error.';
  const after = before + (look?.misplaced_marker ? ` Doubtful: ${look.misplaced_marker.detail}.` : '');
  if (place.dataset.told === text + after) return;
  place.dataset.told = text + after;
  place.replaceChildren(make('b', {}, text), after);
}

const percent = (share) => (share > 0.9995 ? '>\u00a099.9\u00a0%' : `${(100 * share).toFixed(share > 0.99 ? 1 : 0)}\u00a0%`);
