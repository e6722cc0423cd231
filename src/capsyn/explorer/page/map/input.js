import { changed, look, point, zoom } from "../state/changes.js";
import { move, start } from "../state/trajectories.js";
import { isIn, nearest, toPixels, toShares } from "./frame.js";

/** Pixels at which a start is taken hold of, and from which a press is a drag. */
const NEAR = 14, MOVED = 4;

/**
 * Listen to the mouse, or fingers, on a map: pointing, starting a trajectory, dragging a start or
 * the plane, and zooming with the wheel.
 */
export function listenToMouse(map) {
  const { app, overlay } = map;
  /** What is pressed: where [pixels], the bounds then, whether a start, and if it has moved. */
  let held = null;
  overlay.addEventListener("pointerdown", event => {
    if (event.button !== 0) return;
    const at = position(map, event);
    held = { at, bounds: app.view.bounds, start: isAtStart(map, at), moved: false };
    overlay.setPointerCapture(event.pointerId);
  });
  overlay.addEventListener("pointermove", event => {
    const at = position(map, event);
    if (held) drag(map, held, at);
    else hover(map, at);
  });
  overlay.addEventListener("pointerup", event => {
    const pressed = held;
    held = null;
    if (!pressed || pressed.moved) return;
    const shares = toShares(map.frame, position(map, event));
    if (isIn(shares)) start(app, app.view.state(...shares));
  });
  overlay.addEventListener("pointercancel", () => (held = null));
  overlay.addEventListener("pointerleave", () => held || point(app, null));
  overlay.addEventListener("wheel", event => turn(map, event), { passive: false });
}

function position({ overlay }, event) {
  const box = overlay.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}

const distance = ([x0, y0], [x1, y1]) => Math.hypot(x1 - x0, y1 - y0);

/** Whether pixels are at the start of the active trajectory. */
function isAtStart({ app: { active, view }, frame }, at) {
  return Boolean(active) && distance(toPixels(frame, view.place(active.states[0])), at) < NEAR;
}

function hover(map, at) {
  const { app, overlay, frame } = map, shares = toShares(frame, at);
  overlay.classList.toggle("grab", isAtStart(map, at));
  point(app, isIn(shares) ? app.view.state(...shares) : null);
}

function drag({ app, frame }, held, at) {
  if (!held.moved && distance(held.at, at) < MOVED) return;
  held.moved = true;
  if (held.start) {
    move(app, app.view.state(...nearest(toShares(frame, at))));
    return;
  }
  const [left, up] = [(held.at[0] - at[0]) / frame.width, (at[1] - held.at[1]) / frame.height];
  look(app, view => view.move([left, up], held.bounds));
}

function turn(map, event) {
  const { app, overlay, frame } = map;
  if (document.activeElement !== overlay && !event.ctrlKey) {
    app.note("Ctrl and the wheel zoom; the wheel alone once the map has the focus");
    return;
  }
  event.preventDefault();
  const shares = toShares(frame, position(map, event));
  zoom(app, Math.exp(Math.sign(event.deltaY) * 0.2), app.view.state(...shares));
}

/** Shares of the plane that an arrow key moves by, with Shift and without. */
const FINE = 1 / 200, COARSE = 1 / 40;
const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

const KEYS = {
  Enter: start,
  "+": (app, state) => zoom(app, 0.8, state),
  "=": (app, state) => zoom(app, 0.8, state),
  "-": (app, state) => zoom(app, 1.25, state),
  _: (app, state) => zoom(app, 1.25, state),
  0: app => look(app, view => view.reset()),
  Escape: app => point(app, null),
};

/** Listen to the keys while a map has the focus. */
export function listenToKeys({ app, overlay }) {
  overlay.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const { key } = event, at = app.pointed ? app.view.place(app.pointed.state) : [0.5, 0.5];
    if (key in STEPS) step(app, at, STEPS[key], event.shiftKey ? FINE : COARSE);
    else if (key in KEYS) KEYS[key](app, app.view.state(...at));
    else return;
    event.preventDefault();
    event.stopPropagation();
  });
}

/** Point beside shares of the plane; beyond its edge the plane moves. */
function step(app, at, direction, share) {
  const { view } = app, next = at.map((v, k) => v + direction[k] * share);
  const beyond = next.map(v => Math.min(v, 0) + Math.max(v - 1, 0));
  if (beyond.some(Boolean)) view.move(beyond);
  point(app, view.state(...nearest(next)));
  if (beyond.some(Boolean)) changed(app);
}
