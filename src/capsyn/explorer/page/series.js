import uPlot from "../vendor/uPlot.esm.js";
import { extremes } from "./chatter.js";
import { byId, element, tickText, withUnit } from "./dom.js";
import { makeStrips } from "./strips.js";

const HEIGHTS = { state: 96, input: 68, cost: 82 };
const STRIP = 14, FOOT = 24, LEFT = 58, RIGHT = 20;
const FONT = "11px system-ui, sans-serif";
/** Pieces of a curve whose least and greatest samples are drawn. */
const PIECES = 600;
/** Most values of an input that are all ticks. */
const FEW = 3;

/**
 * Return the time series of the tracks: {show, sweep, shown}. `show` takes the tracks and the theme
 * as they are now, `sweep` moves the line of the present, `shown` tells what is drawn.
 */
export function makeSeries(app) {
  const { data } = app, root = byId("series"), strips = makeStrips(app);
  const sync = uPlot.sync("time");
  let plots = [], made = "";

  const rows = [
    ...data.domain.names.map((name, i) => ({
      kind: "state", name: withUnit(name, data.domain.units[i]), value: (track, k) => track.states[k][i],
    })),
    ...data.alphabet.inputs.map((name, i) => ({
      kind: "input", name: withUnit(name, data.alphabet.units[i]), paint: strips.inputs(i),
      values: [...new Set(data.controls.slice(0, -1).map(control => control[i]))].sort((a, b) => a - b),
      all: data.controls.map(control => control[i]), of: symbol => data.controls.at(symbol)[i],
    })),
    { kind: "symbols", name: "symbol", paint: strips.symbols },
    { kind: "cost", name: "running cost so far", value: (track, k) => track.cost[k] },
  ];

  /** The tracks in the order of drawing. */
  const ordered = () => [...app.tracks.filter(track => track !== app.active), app.active];

  function content(row) {
    if (row.paint) return [[0, app.longest()], ...app.tracks.map(() => [0, 0])];
    return uPlot.join(ordered().map(track => {
      const value = k => row.value(track, k), kept = extremes(track.t.length, value, PIECES);
      const shown = kept.map(value);
      return [kept.map(k => track.t[k]), shown.map(v => (Number.isFinite(v) ? v : null))];
    }));
  }

  function axes(row, last) {
    const { theme } = app;
    const common = {
      stroke: theme.quiet, font: FONT,
      grid: { stroke: theme.faint, width: 1 }, ticks: { stroke: theme.faint, width: 1, size: 4 },
    };
    const across = {
      ...common, show: true, size: last ? FOOT : 4, space: 70, gap: 3,
      values: last ? (_, found) => found.map(v => `${tickText(found)(v)} s`) : () => [],
    };
    if (row.kind === "symbols") {
      return [across, { show: true, size: LEFT, grid: { show: false }, ticks: { show: false }, values: () => [] }];
    }
    const few = row.values && (row.values.length <= FEW ? row.values : [row.values[0], row.values.at(-1)]);
    return [across, {
      ...common, size: LEFT, space: 22, gap: 4, values: (_, found) => found.map(tickText(found)),
      ...(few ? { splits: () => few } : {}),
    }];
  }

  function range(row) {
    if (row.kind === "symbols") return () => [0, 1];
    return (_, low, high) => {
      if (row.all) [low, high] = [Math.min(...row.all), Math.max(...row.all)];
      if (low === null) return [0, 1];
      const pad = (high - low || Math.abs(high) || 1) * (row.all ? 0.25 : 0.08);
      return [low - pad, high + pad];
    };
  }

  function options(row, width, last) {
    const { theme } = app, strip = row.kind === "symbols";
    const height = strip ? 10 + STRIP * app.tracks.length : HEIGHTS[row.kind];
    return {
      width, height: height + (last ? FOOT : 0), padding: [strip ? 6 : 17, RIGHT, strip ? 2 : 0, 0],
      legend: { show: false },
      cursor: { sync: { key: sync.key, scales: ["x", null] }, drag: { x: false, y: false }, y: false,
        points: { show: false } },
      scales: { x: { time: false, range: () => [0, app.longest() || 1] }, y: { range: range(row) } },
      axes: axes(row, last),
      series: [{}, ...ordered().map(track => ({
        stroke: theme.track(track.color), width: track === app.active ? 1.8 : 1.2,
        points: { show: false }, spanGaps: true,
        ...(row.paint ? { paths: () => null } : {}),
      }))],
      hooks: { draw: row.paint ? [row.paint] : [] },
    };
  }

  function build(shown) {
    for (const plot of plots) plot.destroy();
    root.replaceChildren();
    const width = root.clientWidth;
    plots = shown.map((row, k) => {
      const note = element("span", { class: "aside" });
      const holder = element("div", { class: `plot ${row.kind}` },
        element("span", { class: "title" }, row.name), note);
      root.append(holder);
      const plot = new uPlot(options(row, width, k === shown.length - 1), content(row), holder);
      Object.assign(plot, { now: element("div", { class: "now" }), row, note });
      plot.over.append(plot.now);
      seek(plot.over, plot);
      return plot;
    });
  }

  function show() {
    root.classList.toggle("empty", !app.tracks.length);
    const costly = app.tracks.some(track => track.cost.at(-1) !== 0);
    const shown = app.tracks.length ? rows.filter(row => row.kind !== "cost" || costly) : [];
    const wanted = JSON.stringify([
      shown.length, app.theme.mode, ordered().map(track => track?.color), app.tracks.map(track => track.color),
    ]);
    if (wanted !== made) build(shown);
    else for (const plot of plots) plot.setData(content(plot.row));
    made = wanted;
    for (const plot of plots) {
      const { row, note } = plot;
      const chatters = row.of && app.tracks.some(track => strips.pieces(track, plot).found.some(
        ({ changes, shares }) => changes > 1 && new Set([...shares.keys()].map(row.of)).size > 1));
      note.textContent = chatters ? "chatters: mean and range" : "";
    }
    sweep();
  }

  function seek(over, plot) {
    let held = false;
    const to = event => {
      const box = over.getBoundingClientRect();
      app.seek(plot.posToVal(event.clientX - box.left, "x"));
    };
    over.addEventListener("pointerdown", event => {
      held = true;
      over.setPointerCapture(event.pointerId);
      to(event);
    });
    over.addEventListener("pointermove", event => held && to(event));
    for (const end of ["pointerup", "pointercancel"]) over.addEventListener(end, () => (held = false));
  }

  function sweep() {
    const share = app.player.time / (app.longest() || 1);
    for (const plot of plots) plot.now.style.left = `${100 * share}%`;
  }

  let width = 0;
  new ResizeObserver(() => {
    if (Math.abs(root.clientWidth - width) < 1) return;
    width = root.clientWidth;
    plots.forEach(plot => plot.setSize({ width, height: plot.height }));
    sweep();
  }).observe(root);

  /** What is drawn: of curves the points, of inputs and symbols the shares in pieces of time. */
  const shown = () => plots.map(plot => ({
    name: plot.row.name,
    kind: plot.row.kind,
    points: plot.row.paint ? null : [plot.data[0], plot.data.at(-1)],
    shares: plot.row.paint && app.active
      ? strips.pieces(app.active, plot).found.map(({ shares }) => Object.fromEntries(shares)) : null,
  }));

  return { show, sweep, shown };
}
