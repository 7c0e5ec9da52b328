// Buttons that want to be held: what lets the arm move is never done by a slip.

const HOLD_MS = 600;

/**
 * Has `act` done when `button` has been held, by pointer or Enter; `slipped` when it was let go too early.
 * How long is judged by the events' own times: a machine that is busy wakes the page late.
 */
export function onHold(button, act, slipped) {
  let timer = null;
  let pressed = 0;
  button.classList.add('hold');
  const begin = (event) => {
    if (timer !== null || button.disabled) return;
    pressed = event.timeStamp;
    button.classList.add('held');
    timer = setTimeout(() => { end(); act(); }, HOLD_MS);
  };
  const end = () => {
    clearTimeout(timer);
    timer = null;
    button.classList.remove('held');
  };
  const letGo = (event) => {
    if (timer === null) return;
    end();
    if (event.timeStamp - pressed >= HOLD_MS) act();
    else slipped();
  };
  button.addEventListener('pointerdown', (event) => { if (event.button === 0) begin(event); });
  for (const kind of ['pointerup', 'pointerleave', 'pointercancel', 'blur']) button.addEventListener(kind, letGo);
  button.addEventListener('keydown', (event) => { if (event.key === 'Enter' && !event.repeat) begin(event); });
  button.addEventListener('keyup', (event) => { if (event.key === 'Enter') letGo(event); });
  button.addEventListener('contextmenu', (event) => event.preventDefault());
}
