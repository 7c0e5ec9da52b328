// What the operator asks for: the group, the procedure, jogging. Each is one public request, shown as a curl line.

import { curl, send } from './api.js';
import { ago, attribute, byId, clock, make, millimetres, write } from './dom.js';
import { onHold } from './hold.js';

const GROUP = [
  { id: 'enable', words: 'ENABLE', path: '/enable', hold: true },
  { id: 'disable', words: 'Disable', path: '/disable' },
  { id: 'reset', words: 'Reset', path: '/reset', hold: true },
  { id: 'release', words: 'Release e-stop', path: '/emergency-release', hold: true },
];
const STEPS = [
  { kind: 'look', words: 'Look', verb: 'Look', free: true },
  { kind: 'orientation-adjustment', words: '1 Turn parallel', verb: 'Turn', aims: true },
  { kind: 'local-track', words: '2 Local calibration', verb: 'Calibrate', method: 'corrected' },
  { kind: 'trajectory-matching', words: '2 Local calibration', verb: 'Calibrate', method: 'paper' },
  { kind: 'look-then-move', words: '3 Go to the target', verb: 'Go', aims: true, calibrated: true },
  { kind: 'looking-and-moving', words: '4 Follow the camera', verb: 'Follow', aims: true, calibrated: true },
  { kind: 'home', words: 'Back to the first pose', verb: 'Go back' },
];
const FRESH_MS = 8000;
const AFTER_STOP = { disabled: 'the arm is disabled', error_stop: 'the fault stays latched' };
const STILL_MOVES = { held: 'The tool rolls out for half a second, and swings: wait until it rests.', shut: 'With its valves shut it sinks slowly.' };
const WHY_NOT = { disabled: 'the arm is disabled: hold ENABLE first', error_stop: 'a fault is latched: reset and enable first', moving: 'the arm moves', stopping: 'the arm is stopping', standby: 'the arm is enabled' };
const WANTED = { disabled: 'hold ENABLE first', error_stop: 'after RESET and ENABLE' }; // for programs that move
const results = new Map(); // of operations that have ended, by id
const rows = []; // [step, its line]
let shot = null;
let may = null; // operate; null: not known yet
let saidFor = null;
let saidWhile = null; // the group's state for which what was said is advice
let chosen = false; // the method, by whoever looks at this page
let goal = () => null; // [id, words] of the target that is shown; null while that is not known

const method = () => byId('method').value;
/** Whether the valves are shut, so that the arm sinks and what was clicked is lost. */
export const sinks = () => shot?.state?.group_state === 'disabled';
const enabled = () => shot?.state?.group_state === 'standby';
export const running = () => shot?.operations.find((operation) => !operation.result && ['queued', 'running'].includes(operation.state));

/** `given()` tells the target that the page shows: what drives to it names it, whatever others click meanwhile. */
export const nameGoal = (given) => { goal = given; };

/** Makes the buttons. */
export function installActions() {
  for (const action of GROUP) byId('group-buttons').append(button(action.words, () => ['POST', action.path], action));
  addSteps(STEPS, byId('procedure'));
  for (const axis of 'xyz') for (const sign of [-1, 1]) {
    byId('jog').append(button(`${sign < 0 ? '−' : '+'} ${axis}`, () => jogRequest(axis, sign), { id: `jog-${axis}${sign < 0 ? '-minus' : '-plus'}` }));
  }
  byId('copy').addEventListener('click', () => navigator.clipboard?.writeText(byId('curl').textContent));
  byId('method').addEventListener('change', () => { chosen = true; update(shot, may); });
  document.addEventListener('stopped', () => advise(`Stopped. What was running has ended; ${AFTER_STOP[shot?.state?.group_state] ?? 'ENABLE still holds'}. ${STILL_MOVES[shot?.state?.group_state === 'disabled' ? 'shut' : 'held']}`));
}

/** Adds a row for every program of your own, once. */
export async function offerPrograms() {
  const answer = await send('GET', '/programs');
  for (const program of answer.ok ? answer.document : []) {
    if (!program.own || rows.some(([step]) => step.kind === program.name)) continue;
    addSteps([{ kind: program.name, words: program.title, verb: 'Run' }], byId('procedure'));
  }
  update(shot, may);
}

/** Adds a row to `place` for each program of `steps`. */
export function addSteps(steps, place) {
  for (const step of steps) {
    rows.push([step, row(step)]);
    place.append(rows.at(-1)[1]);
  }
}

/** A button that sends what `request()` says, by a press or held. */
export function button(words, request, { id, hold } = {}) {
  const made = make('button', { type: 'button', id }, words);
  if (hold) made.append(make('small', {}, 'hold'));
  const act = async () => {
    const asked = request();
    if (!asked) return;
    const answer = await send(...asked);
    say(answer.ok ? `${words}: accepted.` : answer.words, answer.ok, answer.ok);
  };
  if (hold) onHold(made, act, () => say(`${words}: hold it for 0.6 s.`, true));
  else made.addEventListener('click', act);
  tellCurl(made, request);
  return made;
}

/** Shows the curl line of `request()` when `element` is pointed at or gets the focus. */
export function tellCurl(element, request) {
  for (const kind of ['focus', 'pointerenter']) {
    element.addEventListener(kind, () => { const asked = request(); if (asked) showCurl(...asked); });
  }
}

function row(step) {
  const start = button(step.verb, () => stepRequest(step), { id: `start-${step.kind}`, hold: !step.free });
  attribute(start, 'aria-label', `${step.words}${step.free ? '' : ': hold'}`);
  const cancel = make('button', { type: 'button', id: `cancel-${step.kind}`, hidden: true }, 'Cancel');
  const ending = () => { const operation = running(); return operation && ['POST', `/operations/${operation.id}/cancel`]; };
  tellCurl(cancel, ending);
  cancel.addEventListener('click', async () => {
    const asked = ending();
    if (!asked) return;
    const answer = await send(...asked);
    say(answer.ok ? 'Cancelled; the arm was stopped.' : answer.words, answer.ok);
  });
  return make('li', { 'data-kind': step.kind, 'data-method': step.method }, make('span', {}, step.words), make('span', {}, start, cancel), make('progress', { max: 1, value: 0, hidden: true, 'aria-label': `Progress of ${step.words}` }), make('small', { class: 'note' }, ''));
}

function stepRequest(step) {
  if (step.request) return step.request();
  const body = { ...(step.kind === 'look-then-move' && { method: method() }), ...(step.aims && goal()?.id && { target: goal().id }) };
  return ['POST', `/operations/${step.kind}`, ...(Object.keys(body).length ? [body] : [])];
}

function jogRequest(axis, sign) {
  const metres = (sign * Number(byId('jog-step').value)) / 1000;
  const offset = [...'xyz'].map((name) => (name === axis ? metres : 0));
  const frame = byId('jog-frame').value;
  if (frame === 'tool') return ['POST', '/operations/move', { offset_tool_m: offset }];
  if (frame === 'base') return ['POST', '/operations/move', { offset_base_m: offset }];
  const R = shot?.calibration?.R_BC;
  if (!R) { say('Camera axes are known after “trajectory matching”.', false); return null; }
  return ['POST', '/operations/move', { offset_base_m: R.map((line) => Number(line.reduce((sum, r, i) => sum + r * offset[i], 0).toFixed(6))) }];
}

/** Shows the request as a curl line. */
export function showCurl(...asked) {
  write(byId('curl'), curl(...asked));
}

/** One line about the last request, `brief`ly or until something else is said; on a phone it is above STOP. */
export function say(words, fine, brief = false) {
  const said = Date.now() / 1000;
  write(byId('answer'), words);
  attribute(byId('answer'), 'class', !fine ? 'refused' : words ? 'fresh' : '');
  byId('answer').removeAttribute('data-said');
  clearTimeout(saidFor);
  saidWhile = null;
  if (!fine) saidFor = setTimeout(() => attribute(byId('answer'), 'data-said', clock(said)), FRESH_MS); // it stays, as what has been
  if (fine) saidFor = setTimeout(() => (brief ? say('', true) : attribute(byId('answer'), 'class', '')), FRESH_MS);
}

/** Says what is to be done next: no longer once the group's state is another one, whoever has changed it. */
export function advise(words) {
  say(words, true);
  saidWhile = settled(shot?.state);
}

const settled = (state) => (['moving', 'stopping'].includes(state?.group_state) ? 'standby' : state?.group_state ?? null);

/** Brings buttons and rows up to date with a snapshot; `operate`: whether this token may move the arm. */
export function update(snapshot, operate) {
  const state = snapshot?.state;
  if (saidWhile && state && settled(state) !== saidWhile) say('', true); // what was to be done next is not
  shot = snapshot;
  may = operate;
  const busy = running();
  const why = whyNot(busy);
  able('enable', may && state?.group_state === 'disabled', why || WHY_NOT[state?.group_state]);
  able('disable', state && state.group_state !== 'disabled', state ? 'the arm is disabled' : why);
  able('reset', may && state?.group_state === 'error_stop' && !state.emergency_latched, state?.emergency_latched ? 'release the emergency stop first' : state ? 'no fault is latched' : why);
  able('release', may && Boolean(state?.emergency_latched), state ? 'no emergency stop is latched' : why);
  write(byId('procedure-wants'), shot?.link.tries_valves ? 'this controller only tries out valves' : (may && WANTED[state?.group_state]) || '');
  followMethod();
  const due = may && !busy ? dueStep() : null;
  byId('enable').classList.toggle('primary', due === 'enable');
  for (const [step, line] of rows) showStep(step, line, busy, why, due);
  const jog = shot?.operations.findLast((operation) => operation.kind === 'move');
  write(byId('jog-told'), jog && jog !== busy ? words(jog) : '');
  for (const jog of byId('jog').children) able(jog.id, may && enabled() && !busy, why || WHY_NOT[state?.group_state]);
}

/** Why nothing can be asked for, whatever the group's state is; '' where something can. */
function whyNot(busy) {
  if (!shot) return 'no word from the vision PC';
  if (may === null) return 'the vision PC has not told yet who you are';
  if (!may) return 'you may look and stop: sign in to move the arm';
  if (!shot.state) return 'no word from the controller';
  return busy ? `“${busy.title}” is running` : '';
}

function able(id, is, why) {
  const made = byId(id);
  if (made.disabled === Boolean(is)) made.disabled = !is;
  attribute(made, 'title', is ? '' : why);
}

/** What comes next on the way to the target; null where nothing is to be done. */
function dueStep() {
  if (shot?.state?.group_state === 'disabled' && !shot.link.tries_valves) return 'enable';
  if (!enabled()) return null;
  if (calibrated()) return 'look-then-move';
  if (!succeeded('orientation-adjustment')) return 'orientation-adjustment';
  return method() === 'corrected' ? 'local-track' : 'trajectory-matching';
}

const succeeded = (kind) => shot.operations.findLast((operation) => operation.kind === kind && operation.state === 'succeeded' && !(operation.ended_at < shot.anew_at));

/** Who has not chosen a method sees that by which was calibrated last, whoever did it. */
function followMethod() {
  if (chosen || !shot || calibrated()) return;
  if (shot.tracked) byId('method').value = 'corrected';
  else if (shot.calibration) byId('method').value = 'paper';
}

function showStep(step, line, busy, why, due) {
  line.hidden = (Boolean(step.method) && step.method !== method()) || step.wanted?.() === false;
  const last = shot?.operations.findLast((operation) => operation.kind === step.kind);
  const runs = busy && busy === last;
  const known = !step.aims || goal();
  const wants = step.calibrated && enabled() && !calibrated(step) ? 'step 2, Calibrate, comes first' : '';
  able(`start-${step.kind}`, may && !busy && known && !wants && ready(step), why || wants || (ready(step) ? 'the targets are not known yet' : WHY_NOT[shot.state.group_state]));
  byId(`start-${step.kind}`).classList.toggle('primary', due === step.kind);
  byId(`start-${step.kind}`).hidden = Boolean(runs);
  byId(`cancel-${step.kind}`).hidden = !runs || !may;
  const bar = line.querySelector('progress');
  bar.hidden = !runs;
  if (runs) { if (last.progress === null) bar.removeAttribute('value'); else bar.value = last.progress; }
  const note = line.querySelector('.note');
  write(note, last ? words(last) : hint(step, due));
  note.classList.toggle('failed', last?.state === 'failed' && !isOver(last));
}

/** Whether the group's state lets `step` begin. */
function ready(step) {
  return step.free ? shot?.state : enabled();
}

/** Whether what Go (or, of `step`, either calibration) needs is there. */
const calibrated = (step) => Boolean((step?.kind === 'looking-and-moving' && (shot?.tracked || shot?.calibration)) || (method() === 'corrected' ? shot?.tracked : shot?.calibration));

function hint(step, due) {
  if (step.kind === 'look-then-move') return calibrated() ? `ready${toward(goal())}` : 'after step 2, Calibrate';
  if (step.kind === due) return 'next';
  if (step.kind === 'visit') return 'calibrates where that is wanted';
  return '';
}

const toward = (target) => (target?.words ? `: to ${target.words}` : '');

/** What is to be held next to come to the target. */
export function nextStep() {
  if (!enabled()) return 'Next: reset and enable, then click it once more.';
  return calibrated() ? 'Hold Go to drive there.' : 'Next: local calibration (step 2), then Go.';
}

const visited = (targets, worst) => targets.map((each) => `${each.target} ${worst({ x: each.error_mm.x, y: each.error_mm.y }).toFixed(1)} mm beside`).join(', ');

/** Whether a failure was of a link that is there again. */
const isOver = (operation) => Boolean(operation.cause?.startsWith('link.') && shot.state?.plant_link_ok && !shot.link.trouble && !shot.camera.trouble);

/** An operation in one line. */
function words(operation) {
  if (['queued', 'running'].includes(operation.state)) return operation.note;
  const when = ago(shot.time - operation.ended_at);
  if (operation.ended_at < shot.anew_at) return `void, ${when}: the machine was started anew since`;
  if (operation.state === 'failed') return `▲ failed ${when}: ${operation.note} (${operation.cause}). ${isOver(operation) ? 'That is over: repeat the step.' : operation.advice ?? ''}`;
  if (operation.state === 'cancelled') return `cancelled ${when}`;
  fetchResult(operation);
  const target = operation.request?.target;
  return `done ${when}${target && target !== 'markers' ? ` at ${target}` : ''}${summary(operation.kind, results.get(operation.id))}`;
}

async function fetchResult(operation) {
  if (results.has(operation.id)) return;
  results.set(operation.id, null);
  const answer = await send('GET', `/operations/${operation.id}`);
  if (answer.ok && answer.document) results.set(operation.id, answer.document.result);
  else results.delete(operation.id);
  while (results.size > 20) results.delete(results.keys().next().value); // a page stays open over night
}

function summary(kind, result) {
  if (!result) return '';
  const worst = (xyz) => Math.max(...Object.values(xyz).map(Math.abs));
  if (kind === 'orientation-adjustment') return `, ${worst(result.after_deg).toFixed(2)}° left`;
  if (kind === 'trajectory-matching') return `, rotation known to ${result.rotation_std_deg.toFixed(2)}°`;
  if (kind === 'local-track') return `, ${result.samples} samples`;
  if (kind === 'hand-eye-start') return `: ${result.verdict}`;
  if (kind === 'hand-eye-next') return `, ${result.off.mm.toFixed(1)} mm beside`;
  if (kind === 'hand-eye-sample') return `, sample ${result.count}: ±${result.std_mm.toFixed(2)} mm, ±${result.std_deg.toFixed(3)}°`;
  if (kind === 'hand-eye-solve') return `: ${result.verdict}`;
  if (kind === 'visit') return `: ${visited(result.targets, worst)}`;
  if (kind === 'move') return `, ${result.miss_mm.toFixed(1)} mm beside`;
  if (result.look ?? result.error_mm) {
    const error = (result.look ?? result).error_mm;
    return `: ${millimetres([error.x, error.y, error.z], 2)}${result.contradiction ? `. ▲ ${result.contradiction.detail}` : ''}`;
  }
  return '';
}
