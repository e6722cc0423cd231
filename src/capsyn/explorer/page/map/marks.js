import { disc, write, writeOver } from "../dom/canvas.js";
import { readable } from "../dom/colors.js";
import { short } from "../dom/text.js";
import { progress, symbolAt } from "../state/tracks.js";
import { toPixels, within } from "./frame.js";

/** The target: hatched, within a dashed line. */
export function drawTarget(context, { edge, hatch }, theme) {
  context.lineCap = "butt";
  trace(context, hatch, theme.hatch, 1);
  trace(context, edge, theme.halo, 3);
  context.setLineDash([5, 4]);
  trace(context, edge, theme.ink, 1.6);
  context.setLineDash([]);
}

/** Where the running cost is least: within a dotted line. */
export function drawGoal(context, { edge }, theme) {
  context.lineCap = "round";
  context.setLineDash([0, 5]);
  trace(context, edge, theme.halo, 4.5);
  trace(context, edge, theme.ink, 2.4);
  context.setLineDash([]);
}

/** Lines at the exogenous inputs on the map's axes, as they are set. */
export function drawTold(context, { app, frame }) {
  const { data: { domain }, theme, view } = app;
  const [x, y] = toPixels(frame, view.place(view.fixed));
  view.axes.forEach((axis, side) => {
    if (axis < view.states) return;
    const { x: left, y: top, width, height } = frame;
    const line = new Path2D(side ? `M${left} ${y}h${width}` : `M${x} ${top}v${height}`);
    drawLine(context, line, theme, theme.ink, 1.6);
    const text = `${domain.names[axis]} ${short(view.fixed[axis])}`;
    const ahead = x < left + width / 2, below = y < top + 24;
    const at = side ? [left + width - 8, below ? y + 12 : y - 12]
      : [x + (ahead ? 8 : -8), top + 13];
    writeOver(context, text, at, theme, "600 12", !side && ahead ? "left" : "right");
  });
}

function trace(context, path, color, width) {
  context.strokeStyle = color;
  context.lineWidth = width;
  context.stroke(path);
}

/** A line in a colour, with a halo that sets it off. */
function drawLine(context, line, { halo }, color, width, alpha = 1) {
  context.globalAlpha = alpha;
  context.lineJoin = "round";
  context.lineCap = "round";
  trace(context, line, halo, width + 2.5);
  trace(context, line, color, width);
  context.globalAlpha = 1;
}

/** The line of a track, faint where it has still to go. */
export function drawTrack(context, { app, frame, lines }, track) {
  const { theme, view } = app, color = theme.track(track.color), now = progress(app, track);
  const strong = track === app.active, going = now < track.states.length - 1;
  const whole = lines.whole(track, view, frame);
  drawLine(context, whole, theme, color, strong ? 1.6 : 1.2, going ? 0.32 : strong ? 1 : 0.75);
  if (!going) return;
  drawLine(context, lines.until(track, now, view, frame), theme, color, strong ? 2.2 : 1.6);
}

/** Where a track starts, with its number, and where it is, in the colour of its symbol. */
export function drawEnds(context, { app, frame }, track) {
  const { theme, view } = app, color = theme.track(track.color), now = progress(app, track);
  const start = toPixels(frame, view.place(track.states[0]));
  if (within(frame, start)) {
    disc(context, color, start, 8.5, theme.halo, 2);
    write(context, String(track.number), [start[0], start[1] + 0.5], readable(color), "600 11");
  }
  const here = toPixels(frame, view.place(track.states[now]));
  if (now === 0 || !within(frame, here)) return;
  disc(context, theme.paint(symbolAt(track, now)), here, 6, color, 2.5);
}

export function drawPointer(context, { app, frame }) {
  const { theme, view, pointed } = app;
  if (!pointed) return;
  const { cell, state } = pointed, [x, y] = toPixels(frame, view.place(state));
  if (cell && cell.lower) {
    const [[left, bottom], [right, top]] =
      [cell.lower, cell.upper].map(corner => toPixels(frame, view.unturned(corner)));
    const box = new Path2D();
    if (view.n > 1) box.rect(left, top, right - left, bottom - top);
    else box.rect(left, frame.y, right - left, frame.height);
    drawLine(context, box, theme, theme.ink, 1.5);
  }
  const cross = new Path2D(`M${x - 7} ${y}H${x + 7}M${x} ${y - 7}V${y + 7}`);
  drawLine(context, cross, theme, theme.ink, 1.2);
}
