import { byId } from "../dom/elements.js";
import { paintSwatches } from "./swatches.js";
import { coming, progress } from "./tracks.js";

/** Show everything anew: the plane, the level or the outlines have changed. */
export function changed(app) {
  const { view, lookup, parts } = app;
  parts.tools.sync();
  document.body.classList.toggle("whole", view.level >= lookup.levels);
  document.body.classList.toggle("proving", view.proved);
  reread(app);
  drawSoon(app);
}

export function drawSoon({ soon, parts }) {
  soon("map", () => parts.map.draw());
}

/** Show the present: time has gone on, or another track is the active one. */
export function moved(app) {
  const { view, active, parts } = app, before = slice(view);
  parts.bar?.sync();
  if (active && (view.states < view.n || parts.tools.follows())) {
    const state = parts.tools.follows() ? active.states[progress(app, active)] : null;
    view.follow(active.states[coming(app, active)], state);
    parts.tools.sync();
  }
  if (slice(view) !== before) {
    reread(app);
    parts.map.draw();
  } else parts.map.sweep();
  parts.series?.sweep();
  parts.automaton.sweep();
  parts.drawing.draw();
  parts.chips.sweep();
}

/** What the picture of the map depends on of a reading: all but the states of the plane. */
function slice({ axes, fixed, states }) {
  return fixed.filter((_, axis) => axis >= states || !axes.includes(axis)).join();
}

/** Show the tracks: there are others, or others are the active one. */
export function showTracks({ parts }) {
  parts.chips.draw();
  parts.series?.show();
  parts.bar?.sync();
}

export function restyle(app) {
  const { theme, parts } = app;
  byId("theme").textContent = theme.mode === "dark" ? "Light" : "Dark";
  parts.map.draw();
  parts.automaton.draw();
  parts.drawing.draw();
  showTracks(app);
  paintSwatches(theme);
}

/** Zoom by a factor about a state: what is pointed at, or the middle, unless given. */
export function zoom(app, factor, state = app.pointed?.state ?? app.view.state(0.5, 0.5)) {
  look(app, view => view.zoom(factor, state));
}

/** Fade all symbols but one on the map; none for null. */
export function showOnly(app, symbol) {
  app.view.only = symbol;
  drawSoon(app);
}

/** Change the view, and show everything anew. */
export function look(app, change) {
  change(app.view);
  changed(app);
}

/** Point at a state, or at none. */
export function point(app, state) {
  app.pointed = state ? read(app, state) : null;
  app.parts.readout.draw();
  app.soon("sweep", () => app.parts.map.sweep());
}

/** Read the place that is pointed at again: the plane or the other states have changed. */
function reread(app) {
  const { view, pointed, parts } = app;
  if (pointed) app.pointed = read(app, view.state(...view.place(pointed.state)));
  parts.readout.draw();
}

function read({ lookup, view }, state) {
  const cell = lookup.cell(state);
  if (cell && cell.lower) {
    const turned = (edge, i) => edge + state[i] - view.wrapped(state[i], i);
    Object.assign(cell, { lower: cell.lower.map(turned), upper: cell.upper.map(turned) });
  }
  return { state, cell, ...lookup.symbol(state) };
}
