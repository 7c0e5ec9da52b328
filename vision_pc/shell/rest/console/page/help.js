// One sentence for each word that is not everybody's, behind a `?` beside it.

import { byId, make } from './dom.js';

const WORDS = {
  'h-arm': 'Drawn from the encoders and the nominal dimensions: bending and slack are not in it.',
  'h-error': 'How far the tool is from where it shall be, in the camera’s axes: x to the right, y down, z away from the camera. The shaded square is what is allowed.',
  'h-group': 'Disabled: valves shut. Standby: enabled and at rest. Fault: latched until Reset. Release e-stop takes back an emergency stop that was asked for in software.',
  'h-procedure': '1 turns the tool parallel to the target. 2 moves it along a short path and learns how the camera’s axes lie in the arm’s. 3 drives to the target, by odometry corrected on the way. 4 follows every picture instead.',
  'h-jog': 'One straight move along an axis of the tool, the base or the camera.',
  'h-alarms': '▲ 1 act at once, ◆ 2 soon, ● 3 when there is time. A cause has one row; it ends two seconds after it was last seen.',
  'h-layers': 'Predicted place: where 95 of 100 drives end, told before the arm moved.',
  'h-eye-words': 'Residual: how far a marker’s corners lie from where the pose puts them, on average; above 0.5 px something is wrong with light, print or camera.',
};

/** A `?` that opens `sentence`. */
export const help = (sentence) => make('details', { class: 'help' }, make('summary', { 'aria-label': 'What this means' }, '?'), make('p', {}, sentence));

/** Adds the `?` to every heading that has a sentence here. */
export function installHelp() {
  for (const [id, sentence] of Object.entries(WORDS)) {
    const place = byId(id);
    if (place.firstChild) place.firstChild.after(help(sentence)); else place.append(help(sentence));
  }
}
