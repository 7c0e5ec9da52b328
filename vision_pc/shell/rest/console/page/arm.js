// The arm, in one of two drawings: in 3D where a graphics processor draws it, else from the side.

import { byId, write } from './dom.js';
import { installScene, paintScene, showArm as showScene } from './scene.js';
import { showSideView } from './side_view.js';

let last = null;
let made = false; // the 3D scene

/** Shows what this machine draws without effort; the button shows the other. */
export function installArm() {
  made = installScene();
  show3D(made);
  byId('scene-kind').addEventListener('click', () => {
    const wanted = byId('scene-canvas').hidden;
    if (wanted && !made) made = installScene(true);
    if (made) paintScene();
    byId('scene-none').hidden = made || !wanted;
    write(byId('scene-none'), 'This browser draws no 3D.');
    show3D(made && wanted);
  });
}

export function paintArm() {
  if (made) paintScene();
}

function show3D(is) {
  byId('scene-canvas').hidden = !is;
  byId('side-view').toggleAttribute('hidden', is);
  write(byId('scene-kind'), is ? 'Side' : '3D');
  if (last) showArm(last);
}

/** Draws again what is shown, with where the arm really is. */
export function showTruth() {
  if (last) showArm(last);
}

/** Shows a snapshot. */
export function showArm(shot) {
  last = shot;
  const at = shot.state?.X_BT.p_m.map((metres) => (Math.abs(metres) < 5e-4 ? 0 : metres).toFixed(3).replace('-', '−'));
  write(byId('tool-at'), at ? `tool x ${at[0]}  y ${at[1]}  z ${at[2]} m` : 'by its nominal dimensions');
  if (byId('scene-canvas').hidden) showSideView(shot); else showScene(shot);
}
