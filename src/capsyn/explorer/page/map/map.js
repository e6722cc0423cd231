import { cleared, fit } from "../dom/canvas.js";
import { byId } from "../dom/elements.js";
import { ordered } from "../state/tracks.js";
import { drawAxes } from "./axes.js";
import { framed, toPixels } from "./frame.js";
import { goalPaths } from "./goal.js";
import { listenToKeys, listenToMouse } from "./input.js";
import { makeLines } from "./lines.js";
import { drawEnds, drawGoal, drawPointer, drawTarget, drawTold, drawTrack } from "./marks.js";
import { picture } from "./picture.js";
import { drawProved, provedCells } from "./proved.js";
import { targetPaths } from "./target.js";

/**
 * Return the map of the page: {draw, sweep, redraw, shown}. `draw` paints all, `sweep` what moves;
 * `redraw` tells how long a picture takes, and `shown` what is drawn. On the canvas `base` is what
 * stays, the picture and the axes; on `overlay` what moves, and what listens. `frame` is where the
 * plane is [CSS pixels], `scale` the pixels of a canvas per CSS pixel.
 */
export function makeMap(app) {
  const map = {
    app, base: byId("map-base"), overlay: byId("map"),
    frame: { x: 0, y: 0, width: 1, height: 1 }, scale: 1,
    target: null, goal: null, proved: provedCells(app.data), lines: makeLines(), ticks: {},
  };
  listenToMouse(map);
  listenToKeys(map);
  return {
    draw: () => draw(map),
    sweep: () => sweep(map),
    redraw: (width, height) => redraw(map, width, height),
    shown: () => shown(map),
  };
}

function draw(map) {
  const { app, base, overlay } = map, size = fit(base), { scale } = size;
  fit(overlay);
  const frame = framed(size, app.view.n), context = cleared(base, scale);
  const [width, height] = [Math.round(frame.width * scale), Math.round(frame.height * scale)];
  const image = picture(app.lookup, app.view, app.theme, width, height);
  context.putImageData(image, frame.x * scale, frame.y * scale);
  if (app.view.proved) drawProved(context, map.proved, frame, app);
  const pixels = shares => toPixels(frame, shares);
  const target = targetPaths(app, frame, pixels), goal = goalPaths(app, frame, pixels);
  Object.assign(map, { frame, scale, target, goal, ticks: drawAxes(context, frame, app) });
  sweep(map);
}

function sweep(map) {
  const { app, frame, target, goal } = map, context = cleared(map.overlay, map.scale);
  context.save();
  context.beginPath();
  context.rect(frame.x, frame.y, frame.width, frame.height);
  context.clip();
  if (target) drawTarget(context, target, app.theme);
  if (goal) drawGoal(context, goal, app.theme);
  drawTold(context, map);
  const tracks = ordered(app);
  for (const track of tracks) drawTrack(context, map, track);
  drawPointer(context, map);
  context.restore();
  for (const track of tracks) drawEnds(context, map, track);
}

/** Milliseconds that one picture of so many pixels takes, put on a canvas of its own. */
function redraw({ app }, width, height) {
  const canvas = new OffscreenCanvas(width, height), context = canvas.getContext("2d");
  const started = performance.now();
  context.putImageData(picture(app.lookup, app.view, app.theme, width, height), 0, 0);
  return performance.now() - started;
}

function shown({ app, frame, ticks, target, goal, lines }) {
  return {
    frame: { ...frame }, ticks, target: target ? target.points : [], goal: goal ? goal.points : [],
    pieces: app.tracks.map(track => lines.whole(track, app.view, frame).pieces),
  };
}
