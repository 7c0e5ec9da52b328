// Guided hand-eye calibration: programs that are wanted seldom, folded away.

import { addSteps, button, say } from './actions.js';
import { send } from './api.js';
import { attribute, byId, make, write } from './dom.js';

const name = () => byId('hand-eye-name').value.trim();
const named = (path) => () => {
  if (name()) return ['POST', path, { name: name() }];
  say('Give the session a name.', false);
  return null;
};
const HAND_EYE = [
  { kind: 'hand-eye-start', words: '1 Begin a session here', verb: 'Begin', free: true, request: named('/operations/hand-eye-start') },
  { kind: 'hand-eye-sample', words: '2 Sample where the arm stands', verb: 'Sample', free: true },
  { kind: 'hand-eye-next', words: '3 Next pose, then 2 again', verb: 'Drive' },
  { kind: 'hand-eye-solve', words: '4 Solve', verb: 'Solve', free: true },
  { kind: 'hand-eye-back', words: 'Back to the starting pose', verb: 'Drive back' },
];
let ended = null; // the newest hand-eye step that has ended

/** Makes the rows. */
export function installFurther() {
  addSteps(HAND_EYE, byId('hand-eye-steps'));
  const resume = button('Resume', named('/hand-eye/session/resume'), { id: 'hand-eye-resume' });
  attribute(resume, 'aria-label', 'Resume the session of this name');
  resume.addEventListener('click', () => setTimeout(tellSession, 500));
  byId('hand-eye-names').after(resume);
  byId('hand-eye').addEventListener('toggle', () => { if (byId('hand-eye').open) { tellSession(); listSessions(); } });
}

/** Brings what is told of the session up to date, when a step of it has ended. */
export function showFurther(shot) {
  const last = shot.operations.findLast((operation) => operation.kind.startsWith('hand-eye') && operation.ended_at);
  if (!last || last.id === ended || !byId('hand-eye').open) return;
  ended = last.id;
  tellSession();
}

async function tellSession() {
  const answer = await send('GET', '/hand-eye/session');
  const session = answer.document;
  write(byId('hand-eye-told'), !answer.ok ? 'No session is open.'
    : `${session.name}: ${session.count} samples${session.std_mm === null ? '' : `, camera in hand known to ±${session.std_mm.toFixed(2)} mm, ±${session.std_deg.toFixed(3)}°`}.`);
}

async function listSessions() {
  const answer = await send('GET', '/hand-eye/sessions');
  if (answer.ok) byId('hand-eye-names').replaceChildren(...answer.document.names.map((known) => make('option', { value: known })));
}
