// The emulated world, where there is one: where the arm really is, as the emulator itself tells, and the world begun
// anew. Asked of the emulator's own address; nothing of this goes through the services that control the arm.

import { button } from './actions.js';
import { send } from './api.js';
import { byId } from './dom.js';

const EVERY_MS = 200;
const AFTER_TROUBLE_MS = 2000;
const OLD_MS = 1000;
let points = null;
let came = 0;
let face = null;

/** Where the arm really is, as points in its base (m); null where nobody tells, or it was long ago. */
export function truth() {
  return points && performance.now() - came < OLD_MS ? points : null;
}

/** Follows the emulator at `address`, if it is one that tells; `show()` after each answer. */
export async function followEmulator(address, show) {
  if (!address || face) return;
  face = address;
  const offered = await send('GET', `${face}/faults`);
  if (!offered.ok) { face = null; setTimeout(() => followEmulator(address, show), AFTER_TROUBLE_MS); return; }
  byId('emulated').hidden = false;
  if (offered.document.allowed) {
    byId('emulated').append(button('Begin the world anew', () => ['POST', `${face}/world/restart`], { id: 'restart-world', hold: true }));
  }
  poll(show);
}

async function poll(show) {
  const answer = document.hidden ? null : await send('GET', `${face}/truth`);
  if (answer?.status === 404) { byId('truth-told').hidden = true; return; } // it was started without --show-truth
  if (answer?.ok) {
    points = answer.document.arm_points_m;
    came = performance.now();
  }
  byId('truth-told').hidden = !truth();
  show();
  setTimeout(() => poll(show), answer?.ok ? EVERY_MS : AFTER_TROUBLE_MS);
}
