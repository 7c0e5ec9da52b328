// STOP: one click, no question; Space and Esc anywhere but in a text field; repeated until it is acknowledged.

import { ask, refusal } from './api.js';
import { byId, milliseconds, write } from './dom.js';
import { yieldConnections } from './stream.js';

const EVERY_MS = 200;
const LATER_MS = 1000; // once it has not been heard for three seconds
const MOST_UNDER_WAY = 6;
let pressed = null; // when, while there is no acknowledgement

/** Stops the arm. */
export function stop() {
  if (pressed !== null) return;
  pressed = performance.now();
  yieldConnections(false);
  byId('stop-told').className = 'waiting';
  repeat({ underWay: 0, why: '' });
}

function repeat(attempts) {
  if (pressed === null) return;
  if (attempts.underWay < MOST_UNDER_WAY) attempt(attempts);
  const since = performance.now() - pressed;
  if (since > 2 * EVERY_MS) yieldConnections(true); // it may wait behind other windows' streams
  write(byId('stop-told'), since < EVERY_MS ? 'STOP sent …'
    : `▲ NOT acknowledged for ${(since / 1000).toFixed(1)} s${attempts.why && `: ${attempts.why}`}`);
  if (since > 3000) write(byId('stop-told'), `▲ NOT acknowledged for ${Math.round(since / 1000)} s: press the hardware stop${attempts.why && ` (${attempts.why})`}`);
  setTimeout(() => repeat(attempts), since < 3000 ? EVERY_MS : LATER_MS);
}

async function attempt(attempts) {
  attempts.underWay += 1;
  try {
    const answer = await ask('/stop', { method: 'POST', keepalive: true, signal: AbortSignal.timeout(3000) });
    if (answer.ok) acknowledged();
    else attempts.why = refusal(await answer.json().catch(() => null), answer.status).replace('▲ ', '');
  } catch {
    attempts.why = 'the vision PC does not answer';
  } finally {
    attempts.underWay -= 1;
  }
}

function acknowledged() {
  if (pressed === null) return;
  const took = performance.now() - pressed;
  pressed = null;
  byId('stop-told').className = '';
  write(byId('stop-told'), `stopped ${new Date().toLocaleTimeString('en-GB')}, after ${milliseconds(took)}`);
  document.dispatchEvent(new Event('stopped'));
}

const isText = (element) => element instanceof HTMLInputElement && element.type !== 'checkbox';

/** Has the button and the keys stop the arm. */
export function installStop() {
  byId('stop').addEventListener('pointerdown', stop);
  byId('stop').addEventListener('click', stop);
  const keys = (event) => {
    const isStop = event.key === 'Escape' || (event.key === ' ' && !isText(event.target));
    if (!isStop) return;
    if (event.key === ' ') event.preventDefault(); // Space must not press what has the focus, nor scroll
    if (event.type === 'keydown' && !event.repeat) stop();
  };
  addEventListener('keydown', keys, { capture: true });
  addEventListener('keyup', keys, { capture: true });
}
