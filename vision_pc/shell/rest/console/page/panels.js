// Links and health, the ladder of the group's states, the way on after a fault, and alarms.

import { attribute, byId, clock, make, milliseconds, write } from './dom.js';

const STATES = { disabled: 'disabled', standby: 'standby', moving: 'moving', stopping: 'stopping', error_stop: 'fault' };
const TRIALS = {
  disabled: ['◆ ENABLE moves the arm: it begins a trial of the valves',
    'What: one joint after another, to and fro, about 15 minutes in all. The controller was started for that (controller.excitation.enabled).',
    'How far: as shipped 3° a stroke (wrists 5°), 0.2 m at the tool; never more than 15°.',
    'Before: the tool must be empty, and nobody within reach.',
    'To end it: STOP, Space or Esc closes all valves.'],
  moving: ['◆ The valves are being tried out, one joint after another', 'To end it: STOP, Space or Esc closes all valves.'],
  standby: ['The trial of the valves has ended, or was stopped',
    'Disable, then ENABLE goes on with the joint that was not finished.',
    'For the procedure start the controller without controller.excitation.enabled: this one does nothing else.'],
};
TRIALS.stopping = TRIALS.standby;
const MARKS = { 1: '▲', 2: '◆', 3: '●' };

/** Chips of the header: [name, value, priority of what is wrong or 0]; `locked`: nothing is told without a token. */
export function showChips(shot, stale, locked) {
  const state = shot?.state;
  const chips = locked && (stale !== null || !shot) ? [['console', 'wants a token', 1]] : stale !== null || !shot ? [['console', `no word from the vision PC${stale === null ? '' : ` for ${stale} s`}`, 1]] : [
    ['controller', state ? milliseconds(shot.link.age_ms) + ' ago' : 'no session', state ? (shot.link.age_ms > 200 ? 2 : 0) : 1],
    ['plant', !state ? 'unknown' : state.plant_link_ok ? 'answers' : 'silent', !state ? 0 : state.plant_link_ok ? 0 : 1],
    ['camera', shot.camera.trouble ? shot.camera.trouble.replace('link.camera_', '') : `${shot.camera.rate_hz.toFixed(1)} /s`, shot.camera.trouble ? 2 : 0],
    ['recording', shot.recording ? 'on' : 'FAILED', shot.recording ? 0 : 2],
    ['session', !state ? 'none' : shot.link.authenticated ? 'authenticated' : 'not authenticated', 0],
    ['consoles', String(shot.watchers), 0], ...(shot.clock.source === 'plant' ? [['clock', ...pace(shot.clock)]] : []),
  ];
  const list = byId('chips');
  while (list.children.length > chips.length) list.lastChild.remove();
  while (list.children.length < chips.length) list.append(make('li', {}, '', make('b')));
  chips.forEach(([name, value, wrong], index) => {
    const chip = list.children[index];
    attribute(chip, 'class', wrong ? `abnormal-${wrong}` : '');
    chip.firstChild.data = `${name} `;
    write(chip.lastChild, wrong ? `${MARKS[wrong]} ${value}` : value);
  });
}

const pace = ({ goes, pace: times, standing }) => standing ? [`stands: ${standing.waits_for} does not answer`, 1]
  : goes === 'never' ? ['held', 3] : [`${times.toFixed(1)} × real time`, 0];

/** The ladder; the present state is the one that is filled. */
export function showLadder(state) {
  const ladder = byId('ladder');
  if (!ladder.children.length) for (const [name, words] of Object.entries(STATES)) ladder.append(make('li', { 'data-state': name }, words));
  for (const rung of ladder.children) {
    const on = rung.dataset.state === state?.group_state;
    rung.classList.toggle('on', on);
    rung.classList.toggle('fault', on && rung.dataset.state === 'error_stop');
    if (on) attribute(rung, 'aria-current', 'step'); else rung.removeAttribute('aria-current');
  }
}

/** Before ENABLE is held: what it begins, where the controller was started to try out its valves. */
export function showTrials(shot) {
  const [place, enable] = [byId('trials'), byId('enable')];
  place.hidden = !shot.link.tries_valves;
  write(enable.querySelector('small'), place.hidden ? 'hold' : 'hold: it moves');
  if (place.hidden) { enable.removeAttribute('aria-describedby'); return; }
  attribute(enable, 'aria-describedby', 'trials');
  const [lead, ...lines] = TRIALS[shot.state?.group_state] ?? TRIALS.disabled;
  if (place.dataset.told === lead) return;
  place.dataset.told = lead;
  place.replaceChildren(make('strong', {}, lead), make('ul', {}, ...lines.map((line) => make('li', {}, line))));
}

/** Step by step on after a fault: only what is left is to be done. */
export function showResume({ state, alarms, link }) {
  const list = byId('resume');
  const broken = state && (state.group_state === 'error_stop' || state.emergency_latched);
  list.hidden = !broken;
  if (!broken) return;
  const cause = alarms.find((alarm) => alarm.ended_at === null && alarm.cause.startsWith('fault.'));
  const steps = [
    ...(state.emergency_latched ? ['Hold RELEASE: the emergency stop is latched'] : []),
    'Hold RESET',
    link.tries_valves ? 'Hold ENABLE: the trial goes on, and the arm moves' : 'Hold ENABLE; then repeat the step that was interrupted',
  ];
  const rows = [make('li', { class: 'cause' }, cause ? `${cause.detail}. ${cause.advice}` : `fault: ${state.fault}`), ...steps.map((words, index) => make('li', { class: index ? '' : 'next' }, words))];
  const told = rows.map((row) => row.className + row.textContent).join('|');
  if (list.dataset.told !== told) { list.dataset.told = told; list.replaceChildren(...rows); }
}

/** The worst of what is wrong now, in one line that is always in view. */
function showWorst(active) {
  const line = byId('alarm-line');
  const [worst] = active;
  attribute(line, 'class', worst ? `line-${worst.priority}` : '');
  const more = active.length > 1 ? ` (and ${active.length - 1} more)` : '';
  write(line.firstElementChild, worst ? `${MARKS[worst.priority]} ${clock(worst.began_at)} ${worst.detail}. ${worst.advice}${more}` : 'No alarm');
}

/** No alarm is known of while nothing is heard; one that was active still stands there. */
export function showUnknown() {
  const line = byId('alarm-line');
  if (!line.className) write(line.firstElementChild, 'Alarms are not known: nothing is heard');
}

/** Active alarms first, then those that ended. */
export function showAlarms(alarms) {
  const active = alarms.filter((alarm) => alarm.ended_at === null);
  showWorst(active);
  write(byId('alarm-count'), active.length ? `${active.length} active` : 'none active');
  const rows = alarms.map((alarm) => {
    const lasts = alarm.ended_at === null;
    const often = alarm.count > 1 ? ` · ${alarm.count} times` : '';
    const ended = lasts ? '' : alarm.ended_at > alarm.began_at ? `ended ${clock(alarm.ended_at)}` : '';
    return make('tr', { class: lasts ? 'active' : 'ended' },
      make('td', { class: 'num' }, clock(alarm.began_at)),
      make('td', {}, lasts ? make('span', { class: `prio prio-${alarm.priority}` }, `${MARKS[alarm.priority]} ${alarm.priority}`) : make('span', { class: 'prio' }, '–')),
      make('td', {}, `${alarm.detail}. `, make('b', {}, lasts || alarm.ended_at === alarm.began_at ? alarm.advice : ''), make('small', {}, make('code', {}, alarm.cause), ended && ` · ${ended}`, often)));
  });
  if (!rows.length) rows.push(make('tr', { class: 'ended' }, make('td', { colspan: 3 }, 'Nothing has happened since the console was opened.')));
  const told = rows.map((row) => row.textContent).join('|');
  const body = byId('alarm-rows');
  if (body.dataset.told !== told) { body.dataset.told = told; body.replaceChildren(...rows); }
  document.title = active.length ? `${MARKS[active[0].priority]} ${active[0].cause} · Longreach` : 'Longreach console';
}

