// The console: puts the streams and the parts of the page together, and judges what is stale.

import { forgetToken, onTokenWanted, send, setShown, setToken, takeToken } from './api.js';
import { installActions, offerPrograms, say, tellCurl, update } from './actions.js';
import { byId, write } from './dom.js';
import { followEmulator } from './emulator.js';
import { installFurther, showFurther } from './further.js';
import { installHelp } from './help.js';
import { installLayers, pictureAge, showOverlay, showPicture } from './picture.js';
import { showAlarms, showChips, showLadder, showResume, showTrials, showUnknown } from './panels.js';
import { addToPlots, drawPlots, installPlots } from './plots.js';
import { installArm, paintArm, showArm, showTruth } from './arm.js';
import { installStop } from './stop.js';
import { followPictures, followState } from './stream.js';
import { installTargets, showTargets } from './targets.js';
import { showVerdict } from './verdict.js';

const STALE_MS = 500;
const ASK_AGAIN_MS = 2000;
let shot = null;
let came = 0;
let instance = null;
let operate = null; // not known yet
let question = null; // … asked, and not answered yet
let answeredBy = null; // the instance of the service that said who this is
let lastTrouble = null;
let crowded = false; // no place for pictures among the windows of this browser

function showSnapshot(snapshot) {
  if (instance && instance !== snapshot.service.instance) {
    banner('The vision PC was started anew. What it had learned is gone, and the arm is disabled: begin with ENABLE.', true);
    say('', true);
  }
  else if (shot && shot.anew_at !== snapshot.anew_at) {
    banner('The machine was started anew. Local calibration and targets are void: reset and enable, begin with “Turn parallel”, click the targets again.', true);
    say('', true);
  }
  instance = snapshot.service.instance;
  shot = snapshot;
  setShown(snapshot.time);
  came = performance.now();
  if (lastTrouble?.crowded) banner('', false);
  lastTrouble = null;
  if (answeredBy !== instance && !question) whoAmI();
  judge();
  byId('clock').hidden = shot.clock.source !== 'plant' || !operate;
  write(byId('clock'), shot.clock.goes === 'never' ? 'Let time go' : 'Hold time');
  showLadder(shot.state);
  showTrials(shot);
  showResume(shot);
  showAlarms(shot.alarms);
  showOverlay(shot.overlay, shot.tolerance_mm);
  showTargets(shot.overlay?.size, ['moving', 'stopping'].includes(shot.state?.group_state));
  update(shot, operate);
  showVerdict(shot.look, shot.told, shot.time - shot.looked_at);
  showArm(shot);
  showFurther(shot);
  addToPlots(shot);
}

/** Greys what is old, and says so: a page that stands still must not look alive. */
function judge() {
  const old = came ? performance.now() - came : null;
  const stale = old === null || old > STALE_MS;
  document.documentElement.classList.toggle('stale', stale);
  const locked = lastTrouble?.status === 401;
  showChips(shot, stale ? (old === null ? null : Math.round(old / 1000)) : null, locked);
  if (stale) showUnknown();
  if (stale && shot) update(null, false);
  pictureAge(shot?.camera.trouble ? `The camera: ${shot.camera.trouble.replace('link.camera_', '')}.` : stale && locked ? 'Sign in to see the machine.' : stale ? 'The vision PC does not answer.'
    : crowded ? 'Other windows of this browser show the pictures.' : '');
}

function lost(trouble) {
  lastTrouble = trouble;
  if (trouble.status === 401) signIn(trouble.document);
  else if (trouble.crowded) banner('This browser shows the machine in as many windows as it can: close one, and it comes alive here. STOP works.', false);
  else if (trouble.status === 503) banner(`▲ ${trouble.document?.detail ?? 'The vision PC has no place for another console.'}`, true);
}

function noPicture(trouble) {
  crowded = trouble.crowded ?? false;
}

let bannerEnds = null;

function banner(words, brief) {
  const place = byId('banner');
  write(place, words);
  place.hidden = !words;
  place.classList.toggle('note', brief);
  clearTimeout(bannerEnds);
  if (brief) bannerEnds = setTimeout(() => { place.hidden = true; }, 15_000);
}

/** Asked until it is answered: on a slow network the first question may be lost while pictures come. */
async function whoAmI() {
  const mine = question = Symbol('question');
  const answer = await send('GET', '/access');
  const answered = answer.ok && answer.document;
  if (!answered) await new Promise((resolve) => { setTimeout(resolve, ASK_AGAIN_MS); });
  if (mine !== question) return; // asked anew since, with another token
  question = null;
  if (!answered) return;
  answeredBy = instance;
  operate = answer.document.role === 'operate';
  followEmulator(answer.document.emulator_face, showTruth);
  write(byId('whoami'), answer.document.token_wanted ? `${answer.document.role} (token)` : 'operate');
  offerPrograms();
  if (!operate) say('You may look and stop. Sign in with the operator’s token to move the arm.', true);
}

function signIn(document_) {
  const dialog = byId('sign-in');
  if (dialog.open) return;
  write(byId('sign-in-why'), document_?.cause === 'refused.wrong_token' ? `▲ The token is none of this service’s. ${document_.advice ?? ''}` : document_?.advice ?? 'Paste it from its file, or open the address that was printed with #t=…');
  dialog.show(); // not modal: STOP must answer whoever presses it, if only that it was refused
}

function installSignIn(begin) {
  onTokenWanted(signIn);
  byId('sign-in').querySelector('form').addEventListener('submit', () => {
    forgetToken();
    setToken(byId('token').value);
    byId('token').value = '';
    begin();
  });
}

function installTheme() {
  const wanted = matchMedia('(prefers-color-scheme: dark)');
  const paint = () => {
    document.documentElement.dataset.theme = localStorage.getItem('longreach-theme') ?? (wanted.matches ? 'dark' : 'light');
    paintArm();
    installPlots();
  };
  wanted.addEventListener('change', paint);
  byId('theme').addEventListener('click', () => {
    localStorage.setItem('longreach-theme', document.documentElement.dataset.theme === 'dark' ? 'light' : 'dark');
    paint();
  });
  paint();
}

takeToken();
installStop();
installActions();
installFurther();
tellCurl(byId('stop'), () => ['POST', '/stop']);
const clock = () => ['PUT', '/clock', { goes: shot?.clock.goes === 'never' ? 'always' : 'never' }];
byId('clock').addEventListener('click', async () => say((await send(...clock())).words));
tellCurl(byId('clock'), clock);
installLayers();
installHelp();
installArm();
installTheme();
update(null, false);
const again = [followState(showSnapshot, lost), followPictures(showPicture, noPicture)];
installTargets();
installSignIn(() => { answeredBy = null; whoAmI(); for (const begin of again) begin(); });
whoAmI();
addEventListener('keydown', (event) => { // Space stops the arm, so that Enter ticks
  if (event.key === 'Enter' && event.target instanceof HTMLInputElement && event.target.type === 'checkbox') event.target.click();
});
setInterval(judge, 250);
setInterval(() => { if (!document.hidden) drawPlots(); }, 300);
