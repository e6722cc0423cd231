import { cleared, fit } from "../dom/canvas.js";
import { byId, element } from "../dom/elements.js";
import { DEFAULT } from "../policy/symbols.js";
import { progress, symbolAt } from "../state/tracks.js";
import { cartPole, pendulum } from "./cart.js";
import { doubleTank } from "./tanks.js";

const DRAWINGS = { pendulum, "cart-pole": cartPole, "double-tank": doubleTank };

/** Return the animation of the system: {draw}; one without a drawing stays hidden. */
export function makeDrawing(app) {
  const { data } = app, paint = DRAWINGS[data.drawing], panel = byId("drawing");
  panel.hidden = !paint || !data.loops;
  if (panel.hidden) return { draw() {} };
  const canvas = element("canvas", { role: "img", "aria-label": "The system at the present time" });
  panel.append(canvas);
  const strongest = Math.max(...data.controls.map(control => Math.abs(control[0]))) || 1;

  function draw() {
    const size = fit(canvas), context = cleared(canvas, size.scale), track = app.active;
    if (!track) return;
    const now = progress(app, track), symbol = symbolAt(track, now) ?? DEFAULT;
    paint(context, size, app.theme, {
      state: track.states[now], control: data.controls.at(symbol), color: app.theme.color(symbol),
      strongest, data,
    });
    canvas.dataset.state = Array.from(track.states[now]).join(" ");
  }

  new ResizeObserver(draw).observe(canvas);
  return { draw };
}
