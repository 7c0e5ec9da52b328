// Places in the right eye that look alike: which is meant is told by a click there, or by its distance.

import { byId, make } from './dom.js';

const SVG = 'http://www.w3.org/2000/svg';
const LEVELS = 3; // of numbers one above the other, where places lie close together

const mm = ({ distance_mm: far }) => far.toFixed(0);
const nearestFirst = (candidates) => [...candidates].sort((one, other) => one.distance_mm - other.distance_mm);

/** Their distances from the camera, nearest first, in words. */
export const distances = (candidates) => `${nearestFirst(candidates).map(mm).join(', ')} mm`;

/** A button for each; `take(candidate)` is what it does. */
export function offer(candidates, take) {
  const buttons = nearestFirst(candidates).map((candidate) => {
    const button = make('button', { type: 'button', 'aria-label': `It is ${mm(candidate)} mm from the camera` }, mm(candidate));
    button.addEventListener('click', () => take(candidate));
    return button;
  });
  byId('candidates').replaceChildren(...(buttons.length ? ['mm from the camera:', ...buttons] : []));
}

/** Their distances as texts above the crosses at which they are seen. */
export function labels(candidates) {
  const fromLeft = [...candidates].sort((one, other) => one.other_px[0] - other.other_px[0]);
  return fromLeft.map((candidate, index) => {
    const text = document.createElementNS(SVG, 'text');
    text.setAttribute('x', candidate.other_px[0]);
    text.setAttribute('y', candidate.other_px[1] - 22 - 24 * (index % LEVELS));
    text.textContent = mm(candidate);
    return text;
  });
}
