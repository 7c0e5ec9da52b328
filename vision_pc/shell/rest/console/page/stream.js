// The two streams of the page. Each begins anew when it breaks or falls silent; neither runs while nobody sees the page.

import { ask } from './api.js';

const AGAIN_MS = [300, 600, 1200, 2500, 5000];
const STATE = '/events';
const PICTURES = '/camera/live';
const MOST = { [STATE]: 3, [PICTURES]: 2 }; // in all windows of a browser, which has six connections to a service
const YIELDED_MS = 1500;
const SILENT_MS = { [STATE]: 5000, [PICTURES]: 10_000 }; // a stream may stand for ever after the computer has slept
const yields = []; // what has each stream of this page end for a while
const windows = new BroadcastChannel('longreach-console');
windows.addEventListener('message', (event) => yieldHere(event.data));

/**
 * Frees connections for a STOP, where the windows could not count them (`withPlace`): all windows of the browser let
 * go of their pictures, and with `all` of the state too, for a moment.
 */
export function yieldConnections(all) {
  yieldHere({ all });
  windows.postMessage({ all });
}

function yieldHere({ all }) {
  for (const { path, end } of yields) if (all || path !== STATE) end();
}

/** Does `work` while this browser has fewer than `MOST` such streams; a page from elsewhere without TLS cannot count. */
async function withPlace(path, work) {
  if (!navigator.locks) return work();
  for (let place = 1; place <= MOST[path]; place++) {
    const had = await navigator.locks.request(`longreach ${path} ${place}`, { ifAvailable: true }, async (lock) => {
      if (lock) await work();
      return lock !== null;
    });
    if (had) return undefined;
  }
  throw Object.assign(new Error('crowded'), { crowded: true });
}

/** Follows `path` while the page is visible: `read(reader, alive)` until it breaks, then again; `lost(why)` between. */
function follow(path, read, lost) {
  let running = null;
  let failures = 0;
  const begin = async () => {
    const ended = new AbortController();
    running = ended;
    while (!ended.signal.aborted) {
      const silence = new AbortController();
      let silent = null;
      const listen = () => {
        clearTimeout(silent);
        silent = setTimeout(() => silence.abort(), SILENT_MS[path]);
      };
      try {
        await withPlace(path, async () => {
          listen();
          const answer = await ask(path, { signal: AbortSignal.any([ended.signal, silence.signal]) });
          if (!answer.ok) throw Object.assign(new Error('refused'), { document: await answer.json().catch(() => null), status: answer.status });
          await read(answer.body.getReader(), () => { failures = 0; listen(); });
        });
        lost({ status: 0 });
      } catch (error) {
        if (ended.signal.aborted) return;
        lost({ status: error.status ?? 0, document: error.document ?? null, crowded: error.crowded ?? false });
      } finally {
        clearTimeout(silent);
      }
      const wait = AGAIN_MS[Math.min(failures++, AGAIN_MS.length - 1)];
      await new Promise((resolve) => { setTimeout(resolve, wait); });
    }
  };
  const seen = () => {
    if (document.hidden) { running?.abort(); running = null; }
    else if (running === null) begin();
  };
  document.addEventListener('visibilitychange', seen);
  let later = null;
  yields.push({
    path,
    end() {
      running?.abort();
      running = new AbortController(); // nothing begins before the time is over
      clearTimeout(later);
      later = setTimeout(() => { running = null; seen(); }, YIELDED_MS);
    },
  });
  seen();
  return () => { failures = 0; running?.abort(); running = null; seen(); };
}

/** Snapshots of the state. Returns a function that begins anew, such as with another token. */
export function followState(show, lost) {
  return follow(STATE, async (reader, alive) => {
    const text = new TextDecoder();
    let rest = '';
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      rest += text.decode(value, { stream: true });
      const events = rest.split('\n\n');
      rest = events.pop();
      const newest = events.at(-1); // a page that was held up shows what is, not what was
      const data = newest?.split('\n').find((line) => line.startsWith('data: '));
      if (data) { alive(); show(JSON.parse(data.slice(6))); }
    }
  }, lost);
}

/** Pictures: `show({left, right, frame, ageMs, encodedMs})` with the newest whole message; older ones are dropped. */
export function followPictures(show, lost) {
  return follow(PICTURES, async (reader, alive) => {
    let rest = new Uint8Array(0);
    let drawing = false;
    let next = null;
    const draw = async () => {
      if (drawing || !next) return;
      drawing = true;
      const message = next;
      next = null;
      try { await show(picture(message)); } finally { drawing = false; draw(); }
    };
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      rest = joined(rest, value);
      for (let length = whole(rest); length; length = whole(rest)) {
        next = rest.slice(0, length);
        rest = rest.slice(length);
        alive();
      }
      draw();
    }
  }, lost);
}

function joined(first, second) {
  if (!first.length) return second;
  const both = new Uint8Array(first.length + second.length);
  both.set(first);
  both.set(second, first.length);
  return both;
}

/** The length of the message that `bytes` begin with, 0 while it is not whole. */
function whole(bytes) {
  if (bytes.length < 4) return 0;
  const length = 4 + new DataView(bytes.buffer, bytes.byteOffset).getUint32(0, true);
  return bytes.length < length ? 0 : length;
}

const HEADER = 28;

function picture(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset);
  const left = view.getUint32(24, true);
  return {
    ageMs: Number(view.getBigUint64(12, true) - view.getBigUint64(4, true)) / 1e6,
    encodedMs: Number(view.getBigUint64(12, true)) / 1e6,
    frame: view.getUint32(20, true),
    left: new Blob([bytes.subarray(HEADER, HEADER + left)], { type: 'image/jpeg' }),
    right: new Blob([bytes.subarray(HEADER + left)], { type: 'image/jpeg' }),
  };
}
