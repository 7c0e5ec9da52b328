// The arm in 3D, by its drawing: base axes x forward, y left, z up. Drawn only when it has moved by what can be seen:
// encoders tremble at rest, and without a graphics processor each drawing takes a tenth of a second.

import {
  AmbientLight, BufferAttribute, BufferGeometry, Color, CylinderGeometry, DirectionalLight, GridHelper, Line,
  LineBasicMaterial, LineDashedMaterial, Mesh, MeshLambertMaterial, OrbitControls, PerspectiveCamera, Quaternion, Scene,
  SphereGeometry, Vector3, WebGLRenderer,
} from './vendor/three.js';
import { byId } from './dom.js';
import { truth } from './emulator.js';

const MOST = 3000; // points of the driven path
const NEXT_M = 0.004;
const RADII = [0.16, 0.13, 0.1, 0.1, 0.075, 0.05, 0.04, 0.03];
const UP = new Vector3(0, 1, 0);
const SEEN_M = 0.001;
const AGAIN_MS = 200; // between two drawings of a moving arm
let view = null;

/**
 * Makes the scene; false where the browser cannot, or only at the cost of a core of its processor (unless `anyway`).
 */
export function installScene(anyway = false) {
  const canvas = byId('scene-canvas');
  let renderer;
  try {
    const context = canvas.getContext('webgl2', { antialias: true, alpha: true, failIfMajorPerformanceCaveat: !anyway });
    if (!context) return false;
    renderer = new WebGLRenderer({ canvas, context });
  } catch {
    return false;
  }
  const scene = new Scene();
  const camera = new PerspectiveCamera(34, 1, 0.1, 100);
  camera.up.set(0, 0, 1);
  camera.position.set(3.2, -9.5, 4.2);
  const controls = new OrbitControls(camera, canvas);
  controls.target.set(1.9, 0, 1.2);
  controls.enableDamping = false;
  controls.update();
  const sun = new DirectionalLight(0xffffff, 2.2);
  sun.position.set(2, -4, 8);
  scene.add(new AmbientLight(0xffffff, 1.5), sun);
  view = { scene, camera, controls, renderer, canvas, links: [], joints: [], path: [], shownPath: null, aim: null, framed: false, told: '', last: [], really: [], ghost: null };
  paintScene();
  controls.addEventListener('change', draw);
  new ResizeObserver(draw).observe(canvas);
  return true;
}

/** Whether `points` are where `before` were, as far as a person could see. */
export function still(points, before) {
  return points.length === before.length && points.every((point, index) => point.every((value, axis) => Math.abs(value - before[index][axis]) < SEEN_M));
}

/** Takes the colours of the page as it is. */
export function paintScene() {
  if (!view) return;
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => new Color(style.getPropertyValue(name).trim());
  view.scene.remove(view.grid);
  view.grid = new GridHelper(12, 12, colour('--line'), colour('--line'));
  view.grid.rotation.x = Math.PI / 2;
  view.scene.add(view.grid);
  view.steel = new MeshLambertMaterial({ color: colour('--soft') });
  view.joint = new MeshLambertMaterial({ color: colour('--on') });
  view.driven = new LineDashedMaterial({ color: colour('--accent'), dashSize: 0.05, gapSize: 0.035 });
  view.unlike = new LineDashedMaterial({ color: colour('--ghost'), dashSize: 0.08, gapSize: 0.05, depthTest: false });
  view.goal = new MeshLambertMaterial({ color: new Color('#d9a400') });
  view.thin = new LineBasicMaterial({ color: new Color('#d9a400') });
  for (const mesh of view.links) mesh.material = view.steel;
  for (const mesh of view.joints) mesh.material = view.joint;
  if (view.shownPath) view.shownPath.material = view.driven;
  draw();
}

/** Shows a snapshot. */
export function showArm(shot) {
  if (!view || view.canvas.hidden || !shot.skeleton.length || performance.now() - view.drawnAt < AGAIN_MS) return;
  const told = JSON.stringify([shot.look?.time_ns, shot.calibration?.R_BC]);
  const really = truth() ?? [];
  if (told === view.told && still(shot.skeleton, view.last) && still(really, view.really)) return;
  Object.assign(view, { told, last: shot.skeleton, really, drawnAt: performance.now() });
  const points = shot.skeleton.map((point) => new Vector3(...point));
  points.splice(1, 0, new Vector3(0, 0, points[1].z)); // the pillar, then across to the lift's pivot
  if (!view.links.length) build(points);
  points.slice(1).forEach((end, index) => place(view.links[index], points[index], end));
  view.joints.forEach((ball, index) => ball.position.copy(points[index + 1]));
  drive(points.at(-1));
  aim(shot, points.at(-1));
  haunt(really);
  if (!view.framed) frame(points);
  draw();
}

function build(points) {
  const rod = new CylinderGeometry(1, 1, 1, 20);
  const ball = new SphereGeometry(1, 18, 12);
  points.slice(1).forEach((_, index) => {
    const link = new Mesh(rod, view.steel);
    const joint = new Mesh(ball, view.joint);
    joint.scale.setScalar(1.18 * RADII[Math.min(index + 1, RADII.length - 1)]);
    link.userData.radius = RADII[index] ?? 0.03;
    view.links.push(link);
    view.joints.push(joint);
    view.scene.add(link, joint);
  });
}

function place(link, from, to) {
  const along = to.clone().sub(from);
  const length = along.length();
  link.visible = length > 1e-6;
  if (!link.visible) return;
  link.position.copy(from).addScaledVector(along, 0.5);
  link.quaternion.copy(new Quaternion().setFromUnitVectors(UP, along.divideScalar(length)));
  link.scale.set(link.userData.radius, length, link.userData.radius);
}

/** The path of the tool centre point since the page was opened, bounded. */
function drive(tool) {
  const last = view.path.at(-1);
  if (last && last.distanceTo(tool) < NEXT_M) return;
  view.path.push(tool);
  if (view.path.length > MOST) view.path.shift();
  if (view.shownPath) { view.scene.remove(view.shownPath); view.shownPath.geometry.dispose(); }
  view.shownPath = line(view.path, view.driven);
  view.shownPath.computeLineDistances();
  view.scene.add(view.shownPath);
}

function line(points, material) {
  const geometry = new BufferGeometry();
  geometry.setAttribute('position', new BufferAttribute(new Float32Array(points.flatMap((p) => [p.x, p.y, p.z])), 3));
  return new Line(geometry, material);
}

/** The arm as it really is, over everything. */
function haunt(really) {
  if (view.ghost) { view.scene.remove(view.ghost); view.ghost.geometry.dispose(); view.ghost = null; }
  if (!really.length) return;
  const points = really.map((point) => new Vector3(...point));
  points.splice(1, 0, new Vector3(0, 0, points[1].z));
  view.ghost = line(points, view.unlike);
  view.ghost.computeLineDistances();
  view.scene.add(view.ghost);
}

/** Where the tool shall be by the newest look, once the camera's axes are known in the base. */
function aim(shot, tool) {
  const [look, R] = [shot.look, shot.calibration?.R_BC];
  if (view.aim) { view.scene.remove(...view.aim); view.aim[1].geometry.dispose(); view.aim = null; }
  if (!look || !R) return;
  const e = [look.error_mm.x, look.error_mm.y, look.error_mm.z].map((mm) => mm / 1000);
  const from = new Vector3(...look.X_BT.p_m);
  const at = from.clone().add(new Vector3(...R.map((row) => row.reduce((sum, r, i) => sum + r * e[i], 0))));
  const ball = new Mesh(new SphereGeometry(0.045, 16, 12), view.goal);
  ball.position.copy(at);
  view.aim = [ball, line([tool, at], view.thin)];
  view.scene.add(...view.aim);
}

/** Turns the eye to an arm of any size, once. */
function frame(points) {
  const reach = Math.max(...points.map((point) => Math.hypot(point.x, point.y)), 2);
  const height = Math.max(...points.map((point) => point.z), 1);
  view.controls.target.set(0.46 * reach, 0, 0.46 * height);
  view.camera.position.set(0.75 * reach, -2.35 * reach, 0.85 * reach);
  view.controls.update();
  view.framed = true;
}

function draw() {
  if (!view) return;
  const { renderer, canvas, camera, scene } = view;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (!width || document.hidden) return;
  const ratio = Math.min(devicePixelRatio, 2);
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    renderer.setPixelRatio(ratio);
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
  }
  renderer.render(scene, camera);
}
