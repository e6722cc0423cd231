import { changed, showAll, zoom } from "../state/changes.js";
import { point } from "../state/pointing.js";
import { start } from "../state/trajectories.js";
import { nearest } from "./frame.js";

/** Shares of the plane that an arrow key moves by, with Shift and without. */
const FINE = 1 / 200, COARSE = 1 / 40;
const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

/** What keys do at a state. */
const KEYS = {
  Enter: start,
  "+": (app, state) => zoom(app, 0.8, state),
  "=": (app, state) => zoom(app, 0.8, state),
  "-": (app, state) => zoom(app, 1.25, state),
  _: (app, state) => zoom(app, 1.25, state),
  0: showAll,
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
