// Strips of the last two minutes. What is kept is bounded: a page stays open over night.

import uPlot from './vendor/uplot.js';
import { byId, make, write } from './dom.js';
import { help } from './help.js';

const KEPT = 1200; // ten a second for two minutes
const SPAN_S = 120;
const HEIGHT = 122;
const LEGEND = 32; // px of two rows of names
const JOINTS = ['slew', 'lift', 'tilt', 'wrist1', 'wrist2', 'wrist3'];
const STRIPS = [
  { id: 'joint-error', title: 'Joint error, mrad', lines: JOINTS, floor: 0.5, digits: 2, of: (s) => s.state.q_cmd_deg.map((q, i) => ((s.state.q_meas_deg[i] - q) * Math.PI) / 0.18) },
  { id: 'valves', title: 'Valves, %', lines: JOINTS, floor: 5, digits: 0, of: (s) => s.state.valves.map((v) => 100 * v) },
  { id: 'supply', title: 'Supply, bar', lines: ['supply'], floor: 220, zero: true, digits: 0, of: (s) => [s.state.supply_bar] },
  { id: 'lateness', title: 'Controller lateness, µs', lines: ['p99'], help: '99 of 100 scans of the controller began less late than this.', floor: 500, zero: true, digits: 0, of: (s) => [s.state.cycle.lateness_p99_us] },
  { id: 'age', title: 'Age of state, ms', lines: ['age'], help: 'How long ago the newest word of the controller was sent.', floor: 40, zero: true, digits: 0, of: (s) => [s.link.age_ms] },
];
const DASHES = [[], [7, 3], [2, 2], [], [7, 3], [2, 2]]; // thrice for what turns the arm, thrice for its wrist
const made = [];

/** Makes the strips anew, in the colours of the page as it is. */
export function installPlots() {
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(name).trim();
  byId('strips').replaceChildren();
  STRIPS.forEach((strip, index) => {
    const now = make('span', { class: 'live-value' }, '–');
    const place = make('div', {});
    const style_ = (line) => ({ stroke: colour(strip.lines.length === 1 || line < 3 ? '--ink' : '--accent'), width: 1.4, dash: DASHES[line] });
    byId('strips').append(make('div', { id: `strip-${strip.id}` }, make('h3', {}, strip.title, ...(strip.help ? [help(strip.help)] : []), now), ...legend(strip, style_), place));
    const data = made[index]?.data ?? [[], ...strip.lines.map(() => [])];
    const axis = { stroke: colour('--soft'), grid: { stroke: colour('--line'), width: 0.5 }, ticks: { show: false }, font: '11px system-ui', size: 34, gap: 2 };
    const plot = new uPlot({
      width: Math.max(place.clientWidth, 120), height: height(strip), padding: [4, 14, 0, 0], legend: { show: false }, cursor: { show: false },
      scales: { x: { time: false, range: () => [-SPAN_S, 0] }, y: { range: (_, low, high) => range(strip, low, high) } },
      axes: [{ ...axis, size: 25, gap: 7, values: (_, at) => at.map((t) => (t ? `${t} s` : 'now')), splits: () => [-120, -60, 0] }, { ...axis, space: 20 }],
      series: [{}, ...strip.lines.map((_, line) => ({ ...style_(line), points: { show: false } }))],
    }, shown(data), place);
    made[index] = { strip, data, plot, now, place };
  });
}

const height = (strip) => HEIGHT - (strip.lines.length > 1 ? LEGEND : 0);

/** Which line is which joint. */
function legend({ lines }, style) {
  if (lines.length === 1) return [];
  const list = make('ul', { class: 'legend' });
  lines.forEach((name, line) => {
    const { stroke, width, dash } = style(line);
    const sample = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
    sample.setAttribute('viewBox', '0 0 17 5');
    sample.setAttribute('aria-hidden', 'true');
    const drawn = document.createElementNS(sample.namespaceURI, 'path');
    for (const [attribute, value] of Object.entries({ d: 'M0 2.5H17', stroke, 'stroke-width': width, 'stroke-dasharray': dash.join(' ') })) drawn.setAttribute(attribute, value);
    sample.append(drawn);
    list.append(make('li', {}, sample, name));
  });
  return [list];
}

function range({ floor, zero }, low, high) {
  const most = Math.max(Math.abs(low ?? 0), Math.abs(high ?? 0), floor);
  return zero ? [0, 1.1 * most] : [-1.15 * most, 1.15 * most];
}

function shown([times, ...lines]) {
  const last = times.at(-1) ?? 0;
  return [times.map((t) => t - last), ...lines];
}

/** Adds a snapshot; values that are missing leave a gap. */
export function addToPlots(shot) {
  for (const { strip, data, now } of made) {
    if (shot.time === data[0].at(-1)) continue; // a recording that is paused
    const values = shot.state ? strip.of(shot) : strip.lines.map(() => null);
    data[0].push(shot.time);
    values.forEach((value, line) => data[line + 1].push(value));
    while (data[0].length > KEPT || data[0].at(-1) - data[0][0] > SPAN_S) for (const column of data) column.shift();
    const worst = values.reduce((most, value, line) => (value !== null && Math.abs(value) > Math.abs(values[most] ?? 0) ? line : most), 0);
    const of = strip.lines.length > 1 ? `${strip.lines[worst]} ` : '';
    write(now, values[worst] === null ? '–' : of + values[worst].toFixed(strip.digits).replace('-', '−'));
  }
}

/** Draws; called less often than values come. */
export function drawPlots() {
  for (const { strip, data, plot, place } of made) {
    const width = Math.max(place.clientWidth, 120);
    if (plot.width !== width) plot.setSize({ width, height: height(strip) });
    plot.setData(shown(data));
  }
}
