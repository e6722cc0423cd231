import { changed, zoom } from "../state/changes.js";
import { point } from "../state/pointing.js";
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
  app.view.move([left, up], held.bounds);
  changed(app);
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
