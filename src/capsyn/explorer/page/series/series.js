import uPlot from "../../vendor/uPlot.esm.js";
import { byId, element } from "../dom/elements.js";
import { withUnit } from "../dom/text.js";
import { longest, ordered } from "../state/tracks.js";
import { plotData, plotOptions } from "./plots.js";
import { makeStrips } from "./strips.js";

/**
 * Return the time series of the tracks: {show, sweep, shown}. `show` takes the tracks and the theme
 * as they are now, `sweep` moves the line of the present, `shown` tells what is drawn.
 */
export function makeSeries(app) {
  const root = byId("series"), strips = makeStrips(app), rows = rowsOf(app, strips);
  const sync = uPlot.sync("time");
  const series = { app, root, strips, rows, sync, plots: [], built: "", width: 0 };
  new ResizeObserver(() => resize(series)).observe(root);
  return { show: () => show(series), sweep: () => sweep(series), shown: () => shown(series) };
}

/**
 * Return the rows of a policy: its states, its exogenous inputs, its inputs, the symbols and the
 * cost. A curve has `value(track, k)` at sample k, others `paint(plot)`; an input has the `values`
 * that it may have, ascending, for its ticks, `all` with the default control, and `of(symbol)`; an
 * exogenous input has its bounds as both.
 */
function rowsOf({ data: { domain, alphabet, controls }, view: { states, lower, upper } }, strips) {
  return [
    ...domain.names.map((name, i) => ({
      kind: i < states ? "state" : "told", name: withUnit(name, domain.units[i]),
      value: (track, k) => track.states[k][i],
      ...(i < states ? {} : { values: [lower[i], upper[i]], all: [lower[i], upper[i]] }),
    })),
    ...alphabet.inputs.map((name, i) => ({
      kind: "input", name: withUnit(name, alphabet.units[i]), paint: strips.inputs(i),
      values: [...new Set(controls.slice(0, -1).map(control => control[i]))].sort((a, b) => a - b),
      all: controls.map(control => control[i]), of: symbol => controls.at(symbol)[i],
    })),
    { kind: "symbols", name: "symbol", paint: strips.symbols },
    { kind: "cost", name: "running cost so far", value: (track, k) => track.cost[k] },
  ];
}

function show(series) {
  const { app, root, rows } = series, { tracks, theme } = app;
  root.classList.toggle("empty", !tracks.length);
  const costly = tracks.some(track => track.cost.at(-1) !== 0);
  const visible = tracks.length ? rows.filter(row => row.kind !== "cost" || costly) : [];
  const colors = list => list.map(track => track.color);
  const wanted = JSON.stringify([visible.length, theme.mode, colors(ordered(app)), colors(tracks)]);
  if (wanted !== series.built) build(series, visible);
  else for (const plot of series.plots) plot.setData(plotData(plot.row, app));
  series.built = wanted;
  sweep(series);
}

/** Say of an input that is drawn whether it chatters somewhere, at the width that it has. */
function tell({ app, strips }, plot) {
  const { row, note } = plot;
  const chatters = row.of && app.tracks.some(track => strips.pieces(track, plot).some(
    ({ changes, shares }) => changes > 1 && new Set([...shares.keys()].map(row.of)).size > 1));
  if (note) note.textContent = chatters ? "chatters: mean and range" : "";
}

function build(series, visible) {
  const { app, root, sync } = series;
  for (const plot of series.plots) plot.destroy();
  root.replaceChildren();
  const width = root.clientWidth;
  series.plots = visible.map((row, k) => {
    const note = element("span", { class: "aside" }), now = element("div", { class: "now" });
    const holder = element("div", { class: `plot ${row.kind}` },
      element("span", { class: "title" }, row.name), note);
    root.append(holder);
    const options = plotOptions(row, app, sync.key, width, k === visible.length - 1);
    const plot = new uPlot(options, plotData(row, app), holder);
    Object.assign(plot, { now, row, note });
    plot.hooks.draw = [...(plot.hooks.draw ?? []), () => tell(series, plot)];
    plot.over.append(now);
    listen(app, plot);
    return plot;
  });
}

/** Go to the time that is pressed. */
function listen(app, plot) {
  const { over } = plot;
  let held = false;
  const seek = event => {
    const box = over.getBoundingClientRect();
    app.player.pause();
    app.player.seek(plot.posToVal(event.clientX - box.left, "x"));
  };
  over.addEventListener("pointerdown", event => {
    held = true;
    over.setPointerCapture(event.pointerId);
    seek(event);
  });
  over.addEventListener("pointermove", event => held && seek(event));
  for (const end of ["pointerup", "pointercancel"]) {
    over.addEventListener(end, () => (held = false));
  }
}

function sweep({ app, plots }) {
  const share = app.player.time / (longest(app.tracks) || 1);
  for (const plot of plots) plot.now.style.left = `${100 * share}%`;
}

function resize(series) {
  const { root, plots } = series;
  if (Math.abs(root.clientWidth - series.width) < 1) return;
  series.width = root.clientWidth;
  plots.forEach(plot => plot.setSize({ width: series.width, height: plot.height }));
  sweep(series);
}

/** What is drawn: of curves the points, of inputs and symbols the shares in pieces of time. */
function shown({ app, plots, strips }) {
  return plots.map(plot => ({
    name: plot.row.name,
    kind: plot.row.kind,
    points: plot.row.paint ? null : [plot.data[0], plot.data.at(-1)],
    shares: plot.row.paint && app.active
      ? strips.pieces(app.active, plot).map(({ shares }) => Object.fromEntries(shares)) : null,
  }));
}
