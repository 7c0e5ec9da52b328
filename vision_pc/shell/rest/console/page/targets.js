// Targets by a click in the picture: what was recognised there, how well it is known, whether the arm reaches it.

import { addSteps, advise, nameGoal, nextStep, running, say, showCurl, sinks, tellCurl } from './actions.js';
import { MEASURING_MS, refusal, send } from './api.js';
import { distances, labels, offer } from './candidates.js';
import { attribute, byId, make } from './dom.js';

const SVG = 'http://www.w3.org/2000/svg';
const EVERY_MS = 1000;
const STEP_PX = 10; // of the cross that keys move; with Shift one pixel
const KNOWN = { measured: 'seen', carried: 'carried by odometry', lost: '▲ lost: click it again' };
const IN_MOTION = '▲ The arm moves. Wait until it is at rest, then find holes.';
let size = [1280, 720]; // of the camera's pictures
let targets = [];
let holes = []; // as found from where the arm is: they stay drawn, for a row of targets is clicked one by one
let asked = null; // the click that wants its place in the other eye: its body, and candidates
let cross = null; // where keys have pointed: in which eye, and at which pixel
let measuring = false; // what was clicked
let polling = false;
let moves = false; // the arm: what was seen in a picture is elsewhere in the next
let ours = true; // what is aimed at may be another: this page has just asked for it, or a program ran

/** Has clicks make targets, where the service knows them. */
export async function installTargets() {
  const answer = await send('GET', '/targets');
  if (!answer.ok) {
    if (answer.status !== 404) setTimeout(installTargets, 3000); // such as before somebody signed in
    else nameGoal(() => ({})); // this service knows markers alone
    return;
  }
  byId('targets').hidden = false;
  nameGoal(() => ({ id: aimed()?.id ?? 'markers', words: named(aimed()) }));
  addSteps([{ kind: 'visit', words: 'Visit all targets, the oldest first', verb: 'Visit', wanted: () => targets.length > 1, request: () => ['POST', '/operations/visit', { targets: targets.map((target) => target.id) }] }], byId('target-steps'));
  take(answer.document);
  byId('left').parentElement.classList.add('aimable');
  for (const eye of ['left', 'right']) {
    attribute(byId(eye), 'tabindex', '0');
    byId(eye).addEventListener('keydown', (event) => keys(event, eye));
    byId(eye).addEventListener('blur', () => { cross = null; draw(); });
  }
  attribute(byId('right'), 'aria-label', 'Right eye, live. Where the left eye does not tell the place alone, click it here, or point with the arrow keys and press Enter');
  attribute(byId('left'), 'aria-label', 'Left eye, live. Click a place, or point with the arrow keys and press Enter, to make it the target');
  byId('left').parentElement.addEventListener('click', (event) => click(pixel(event, byId('left'))));
  byId('right').addEventListener('click', (event) => clickRight(pixel(event, byId('right'))));
  byId('find-holes').addEventListener('click', find);
  tellCurl(byId('find-holes'), () => ['GET', '/targets?detect=true']);
  setInterval(poll, EVERY_MS);
}

/** The size of the pictures, which clicks are told in, and whether the arm moves. */
export function showTargets(given, moving) {
  if (running()) ours = true;
  if (given) size = given;
  if (moving === moves) return;
  moves = moving;
  if (moves) { holes = []; askFor(null); }
  draw();
}

/** What programs look at in place of the object's markers. */
export const aimed = () => targets.find((target) => target.aimed);

function pixel(event, canvas) {
  const box = canvas.getBoundingClientRect();
  return [((event.clientX - box.left) / box.width) * size[0], ((event.clientY - box.top) / box.height) * size[1]].map((px) => Number(px.toFixed(1)));
}

function keys(event, eye) {
  const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (event.key === 'Enter' && cross) (eye === 'left' ? click : clickRight)(cross.at);
  if (!way) return;
  event.preventDefault();
  const step = event.shiftKey ? 1 : STEP_PX;
  const from = cross?.at ?? [size[0] / 2, size[1] / 2];
  cross = { eye, at: from.map((at, axis) => Math.min(Math.max(at + step * way[axis], 0), size[axis])) };
  draw();
}

/** A click in the left eye: bound to the picture that was on the screen. */
function click([u, v]) {
  const frame = Number(byId('left').dataset.frame);
  if (!frame) { say('There is no picture yet: wait for one, then click.', false); return null; }
  return ask({ u_px: u, v_px: v, frame_id: frame });
}

/** The same place in the right eye, where the left alone does not tell it. */
function clickRight([u, v]) {
  if (!asked) { say('Click in the left eye first; the right one is asked for when the left alone does not tell the place.', true); return null; }
  return ask({ ...asked.body, other_u_px: u, other_v_px: v });
}

/** One at a time: a double click is one target. */
async function ask(body) {
  if (measuring) return;
  if (sinks()) { say('The arm is disabled: it sinks, and what is clicked is lost. Hold ENABLE, then click.', false); return; }
  measuring = ours = true;
  showCurl('POST', '/targets', body);
  say('Measuring what is there …', true);
  const answer = await send('POST', '/targets', body, MEASURING_MS);
  measuring = false;
  askFor(null);
  if (answer.ok) {
    const made = answer.document;
    const chosen = 'other_u_px' in body ? ` You chose how far it is: ${(1000 * Math.hypot(...made.X_CO.p_m)).toFixed(0)} mm from the camera. Can that be?` : '';
    const told = `Target ${made.id}: ${made.recognised}, known to ${precision(made)}${far(made)}.${chosen}`;
    if (made.reachable === false) say(`${told} Jog nearer, then click it again.`, false);
    else advise(`${told} ${nextStep()}`);
  } else {
    const candidates = answer.document?.candidates ?? [];
    if (candidates.length) askFor({ body, candidates });
    const advice = `Click the same place in the right eye, where the candidates are drawn, or take one by its distance from the camera: ${candidates.length && distances(candidates)}`;
    say(candidates.length ? refusal({ ...answer.document, advice }) : answer.words, false);
    if (candidates.length && document.activeElement === byId('left')) pointRight(candidates[0].other_px);
  }
  await refresh();
}

/** The right eye is large for as long as a place is wanted in it: what looks alike lies close together. */
function askFor(question) {
  asked = question;
  byId('right-place').closest('.under').classList.toggle('asked', asked !== null);
  offer(asked?.candidates ?? [], (candidate) => clickRight(candidate.other_px));
}

/** Who points by keys goes on in the right eye, from the likeliest place on. */
function pointRight(at) {
  byId('right').focus();
  cross = { eye: 'right', at };
}

/** At rest only: outlines of a picture in motion would stay drawn beside the holes, and be clicked there. */
async function find() {
  if (moves) { say(IN_MOTION, false); return; }
  say('Looking for holes …', true);
  const answer = await send('GET', '/targets?detect=true', undefined, MEASURING_MS);
  if (!answer.ok) { say(answer.words, false); return; }
  if (moves) { say(IN_MOTION, false); return; }
  holes = answer.document.holes;
  take(answer.document);
  say(holes.length ? `${holes.length} holes found: click one to make it the target.` : 'No hole was found in this picture.', true);
}

/** ``own``: after what this page has asked for, which is done. */
async function refresh(own = true) {
  const answer = await send('GET', '/targets');
  if (!answer.ok) return;
  if (!own && !ours) tellChanged(answer.document.targets.find((target) => target.aimed));
  if (own || !measuring) ours = false;
  take(answer.document);
}

/** Who was told "hold Go to drive there" must not drive to what another console has clicked since. */
function tellChanged(now) {
  if (now?.id === aimed()?.id) return;
  say(`▲ Not by this page, the target is another one now: ${named(now)}.${now ? ' Go drives there.' : ''}`, false);
}

/** One request at a time: those that wait in vain must not take the connections that STOP needs. */
async function poll() {
  if (document.hidden || polling) return;
  polling = true;
  await refresh(false);
  polling = false;
}

function take(document_) {
  targets = document_.targets;
  rows();
  draw();
}

const precision = ({ std_sight_mm: { across, along } }) => `±${across.toFixed(1)} mm across, ±${along.toFixed(1)} mm in depth`;
const named = (target) => (target ? `${target.id} ${target.recognised}` : 'the object’s markers');
const far = (target) => (target.distance_mm === null ? '' : `, ${target.distance_mm.toFixed(0)} mm away${target.reachable ? '' : ', OUT OF REACH of one step'}`);

function rows() {
  const told = JSON.stringify(targets.map((t) => [t.id, t.known, t.aimed, t.kind, t.recognised, t.std_sight_mm, t.distance_mm]));
  const list = byId('target-rows');
  if (list.dataset.told === told) return;
  list.dataset.told = told;
  const markers = { id: '', aimed: !aimed(), recognised: named(), known: '' };
  list.replaceChildren(...[markers, ...targets].map(row));
  const line = list.querySelector('.aimed'); // of a long row the newest, which is aimed at, is the last
  if (line) list.scrollTop = line.offsetTop - list.offsetTop;
}

function row(target) {
  const name = target.id ? named(target) : target.recognised;
  const line = make('li', { class: target.aimed ? 'aimed' : '' }, make('b', {}, target.aimed ? `◎ ${name}` : name));
  if (!target.id) return line;
  line.append(make('span', {}, `${KNOWN[target.known] ?? target.known} · ${precision(target)}${far(target)}`));
  const aim = make('button', { type: 'button', disabled: target.aimed, 'aria-label': `Aim at ${name}` }, 'Aim');
  const forget = make('button', { type: 'button', 'aria-label': `Forget ${name}` }, 'Forget');
  act(aim, 'POST', `/targets/${target.id}/aim`);
  act(forget, 'DELETE', `/targets/${target.id}`);
  line.append(make('span', { class: 'acts' }, aim, forget));
  return line;
}

function act(button, method, path) {
  tellCurl(button, () => [method, path]);
  button.addEventListener('click', async () => {
    ours = true;
    const answer = await send(method, path);
    if (!answer.ok) say(answer.words, false);
    await refresh();
  });
}

/** Outlines of targets that are seen from here, of holes that were found, candidates, and the keys' cross. */
function draw() {
  const seen = targets.filter((target) => target.known === 'measured' && !target.carried_mm && !moves);
  byId('aims').setAttribute('viewBox', `0 0 ${size[0]} ${size[1]}`);
  byId('aims').replaceChildren(
    ...holes.map((hole) => path(hole.outline, 'hole')),
    ...seen.map((target) => path(target.outline, target.aimed ? 'goal' : 'kept')),
    ...(cross?.eye === 'left' ? [mark(cross.at, 'cross')] : []),
  );
  byId('right-aims').setAttribute('viewBox', `0 0 ${size[0]} ${size[1]}`);
  byId('right-aims').replaceChildren(
    ...(asked?.candidates ?? []).map((candidate) => mark(candidate.other_px, 'cross')),
    ...labels(asked?.candidates ?? []),
    ...(cross?.eye === 'right' ? [mark(cross.at, 'kept')] : []),
  );
}

function path(points, kind) {
  return shape(`M${points.map((point) => point.join(' ')).join('L')}Z`, kind);
}

const mark = ([u, v], kind) => shape(`M${u - 16} ${v}H${u + 16}M${u} ${v - 16}V${v + 16}`, kind);

function shape(d, kind) {
  const element = document.createElementNS(SVG, 'path');
  element.setAttribute('d', d);
  element.setAttribute('class', kind);
  return element;
}
