// A recording in place of the machine: play, pause, seek. Nothing can be asked of the arm, and STOP is not there.

import { send } from './api.js';
import { attribute, byId, make, write } from './dom.js';

/** Whether this page shows a recording: the one who serves it says so. */
export const recorded = 'recorded' in document.documentElement.dataset;

const STEP_S = 5;
let standing = null;
let dragged = false; // the slider is held: what is told meanwhile does not move it
let jumps = null;

/** Puts the transport in the place of STOP. */
export function installTransport() {
  if (!recorded) return;
  byId('stop-place').hidden = true;
  byId('transport').hidden = false;
  write(byId('keys-told'), 'Space plays and pauses; the arrow keys go five seconds back and on. This is a recording: nothing here moves an arm.');
  byId('play').addEventListener('click', toggle);
  byId('seek').addEventListener('input', () => { dragged = true; change({ at_s: Number(byId('seek').value) }); });
  byId('seek').addEventListener('change', () => { dragged = false; });
  byId('speed').addEventListener('change', () => change({ speed: Number(byId('speed').value) }));
  addEventListener('keydown', (event) => {
    if (event.target.matches?.('select, dialog *')) return;
    const way = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (event.key !== ' ' && !way) return;
    event.preventDefault();
    if (event.key === ' ') { if (!event.repeat) toggle(); } else if (standing) change({ at_s: Math.min(Math.max(standing.at_s + way * STEP_S, 0), standing.length_s) });
  }, { capture: true });
  // A button in focus is pressed when Space is let go.
  addEventListener('keyup', (event) => { if (event.key === ' ' && event.target.matches?.('button')) event.preventDefault(); }, { capture: true });
}

const toggle = () => { if (standing) change({ playing: !standing.playing }); };

async function change(body) {
  const answer = await send('POST', '/recording', body);
  if (answer.ok) showTransport(answer.document);
  else write(byId('transport-told'), answer.words);
}

/** Shows how the playback stands. Returns whether it has jumped since the last time. */
export function showTransport(told) {
  standing = told;
  const seek = byId('seek');
  attribute(seek, 'max', told.length_s.toFixed(1));
  if (!dragged) seek.value = told.at_s;
  attribute(seek, 'aria-valuetext', minutes(told.at_s));
  write(byId('play'), told.playing ? 'Pause' : 'Play');
  write(byId('at'), `${minutes(told.at_s)} / ${minutes(told.length_s)}`);
  const speed = byId('speed');
  if (!speed.children.length) speed.append(...told.speeds.map((each) => make('option', { value: each }, `${each} ×`)));
  if (speed.value !== String(told.speed)) speed.value = told.speed;
  write(byId('transport-told'), '');
  const jumped = jumps !== null && jumps !== told.jumps;
  jumps = told.jumps;
  return jumped;
}

/** Seconds as minutes and seconds. */
export function minutes(seconds) {
  const whole = Math.floor(seconds + 1e-6);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, '0')}`;
}

/** What stands in the header in place of links and health. */
export function chipsOf(shot) {
  const { file, pictures, states, damaged } = shot.recorded;
  return [
    ['file', file, 0],
    ['controller', states, states === 'as recorded' ? 0 : 3],
    ['pictures', pictures, /^(none|.* not as recorded)/.test(pictures) ? 3 : 0],
    ...(damaged ? [['damaged', `${damaged} places could not be read`, 2]] : []),
  ];
}
