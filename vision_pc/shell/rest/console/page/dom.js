// Small helpers: elements, text that is written only when it changes, words for numbers and times.

export const byId = (id) => document.getElementById(id);

/** An element of `tag` with `attributes` and `children` (elements or text). */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === true) element.setAttribute(name, '');
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

/** Writes `value` as the text of `element`, if it is another than before: readers are told of changes alone. */
export function write(element, value) {
  const text = String(value);
  if (element.textContent !== text) element.textContent = text;
}

export function attribute(element, name, value) {
  if (element.getAttribute(name) !== String(value)) element.setAttribute(name, value);
}

/** A number with its sign and a true minus. */
export function signed(value, digits = 2) {
  return (value < 0 ? '−' : '+') + Math.abs(value).toFixed(digits);
}

/** Three lengths in mm with their axes. */
export const millimetres = (xyz, digits) => `${xyz.map((mm, axis) => `${'xyz'[axis]} ${signed(mm, digits)}`).join(', ')} mm`;

/** A time of day. */
export function clock(seconds) {
  return new Date(1000 * seconds).toLocaleTimeString('en-GB');
}

/** How long ago, in words. */
export function ago(seconds) {
  if (seconds < 1) return 'now';
  if (seconds < 90) return `${Math.round(seconds)} s ago`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min ago`;
  return `${(seconds / 3600).toFixed(1)} h ago`;
}

export function milliseconds(value) {
  return value < 10 ? `${value.toFixed(1)} ms` : `${Math.round(value)} ms`;
}
