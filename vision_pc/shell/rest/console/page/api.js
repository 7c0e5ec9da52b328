// Every request of the page: the token, the words of a refusal, and the same as a curl line.

const KEY = 'longreach-token';
const PATIENCE_MS = 10_000;
export const MEASURING_MS = 30_000; // on a machine that is busy
let wanted = () => {};
let shown = null;

/** Takes a token out of the address (`#t=…`), where it reaches no log, into this tab's memory. */
export function takeToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get('t');
  if (given) {
    sessionStorage.setItem(KEY, given);
    history.replaceState(null, '', location.pathname + location.search);
  }
}

export const setToken = (token) => sessionStorage.setItem(KEY, token.trim());
export const forgetToken = () => sessionStorage.removeItem(KEY);
/** The service's `time` of what the page shows: what is asked of it and comes much later is refused. */
export const setShown = (time) => { shown = time; };
export const onTokenWanted = (tell) => { wanted = tell; };

/** Whether `path` is of this service; else it is the emulator's own address, which gets no token of ours. */
const isOurs = (path) => path.startsWith('/');

/** `fetch` with the token, never with what the browser remembers. */
export function ask(path, options = {}) {
  const token = isOurs(path) && sessionStorage.getItem(KEY);
  const headers = { ...options.headers };
  if (token) headers.Authorization = `Bearer ${token}`;
  return fetch(path, { ...options, headers, credentials: 'omit', cache: 'no-store' });
}

/** What a request led to: `ok`, `status`, the document, and a sentence for a person; `patience` in ms. */
export async function send(method, path, body, patience = PATIENCE_MS) {
  const options = { method, headers: {} };
  if (shown !== null && isOurs(path) && method === 'POST') options.headers['Longreach-Shown'] = String(shown);
  if (body !== undefined) {
    options.headers['Content-Type'] = 'application/json';
    options.body = JSON.stringify(body);
  }
  let answer;
  try {
    answer = await ask(path, { ...options, signal: AbortSignal.timeout(patience) });
  } catch (error) {
    return { ok: false, status: 0, document: null, words: unanswered(error.name === 'TimeoutError' && patience, method, isOurs(path) ? 'vision PC' : 'emulator') };
  }
  const document = await answer.json().catch(() => null);
  if (answer.status === 401 && isOurs(path)) wanted(document);
  return { ok: answer.ok, status: answer.status, document, words: answer.ok ? '' : refusal(document, answer.status) };
}

/** Who did not answer may have heard all the same, and still do it. */
function unanswered(patience, method, who) {
  const silent = patience ? `▲ The ${who} has not answered for ${patience / 1000} s` : `▲ The ${who} does not answer`;
  return method === 'GET' ? `${silent}. Ask once more.` : `${silent}: it may still do what was asked. Watch the arm; STOP ends it.`;
}

/** A problem document as one line. */
export function refusal(document, status) {
  if (!document) return `Refused (${status}).`;
  return [`▲ ${document.detail} (${document.cause})`, document.advice].filter(Boolean).join('. ');
}

/** The same request for a shell. */
export function curl(method, path, body) {
  const parts = ['curl'];
  if (method !== 'GET') parts.push(`-X ${method}`);
  parts.push(isOurs(path) ? location.origin + path : path);
  if (isOurs(path) && sessionStorage.getItem(KEY)) parts.push(`-H "Authorization: Bearer $token"`);
  if (body !== undefined) parts.push(`-H 'content-type: application/json' -d '${JSON.stringify(body)}'`);
  return parts.join(' ');
}
