import uPlot from "../vendor/uPlot.esm.js";
import { byId, element, short, withUnit } from "./dom.js";

const HEIGHTS = { state: 96, input: 68, cost: 82 };
const STRIP = 12, FOOT = 24, LEFT = 58, RIGHT = 12;
const FONT = "11px system-ui, sans-serif";
/** More curves of samples than this are thinned for drawing. */
const MOST = 4000;

/**
 * Return the time series of the tracks: {show, sweep}. `show` makes the plots anew from the tracks
 * and the theme, `sweep` moves the line of the present.
 */
export function makeSeries(app) {
  const { data } = app, root = byId("series");
  const sync = uPlot.sync("time");
  let plots = [];

  const rows = [
    ...data.domain.names.map((name, i) => ({
      kind: "state", name: withUnit(name, data.domain.units[i]), value: (track, k) => track.states[k][i],
    })),
    ...data.alphabet.inputs.map((name, i) => ({
      kind: "input", name: withUnit(name, data.alphabet.units[i]), stepped: true,
      value: (track, k) => data.controls.at(track.symbols[Math.min(k, track.symbols.length - 1)])[i],
    })),
    { kind: "symbols", name: "symbol" },
    { kind: "cost", name: "cost so far", value: (track, k) => track.cost[k] },
  ];

  /** Samples of a track that are drawn: all, or so many that none is missed by eye. */
  function samples(track, stepped) {
    const last = track.t.length - 1, keep = [], every = Math.ceil((last + 1) / MOST);
    for (let k = 0; k <= last; k++) {
      const changed = stepped && k && track.symbols[k] !== track.symbols[k - 1];
      if (k % every === 0 || k === last || changed) keep.push(k);
    }
    return keep;
  }

  function table(row) {
    const tables = app.tracks.map(track => {
      const kept = samples(track, row.stepped);
      return [kept.map(k => track.t[k]), kept.map(k => row.value(track, k))];
    });
    return uPlot.join(tables);
  }

  function axes(last) {
    const { theme } = app;
    const common = {
      stroke: theme.quiet, font: FONT,
      grid: { stroke: theme.faint, width: 1 }, ticks: { stroke: theme.faint, width: 1, size: 4 },
    };
    return [
      {
        ...common, show: true, size: last ? FOOT : 4, space: 70, gap: 3,
        values: last ? (_, found) => found.map(v => `${short(v)} s`) : () => [],
      },
      { ...common, size: LEFT, space: 26, gap: 4, values: (_, found) => found.map(v => short(v, 3)) },
    ];
  }

  function options(row, width, last) {
    const { theme } = app, base = row.kind === "symbols" ? strip() : HEIGHTS[row.kind];
    return {
      width, height: base + (last ? FOOT : 0), padding: [row.kind === "symbols" ? 6 : 17, RIGHT, row.kind === "symbols" ? 2 : 0, 0],
      legend: { show: false },
      cursor: { sync: { key: sync.key, scales: ["x", null] }, drag: { x: false, y: false }, y: false,
        points: { show: false } },
      scales: {
        x: { time: false, range: () => [0, app.longest() || 1] },
        y: row.kind === "symbols" ? { range: () => [0, 1] } : {
          range: (_, low, high) => {
            if (low === null) return [0, 1];
            const pad = (high - low || Math.abs(high) || 1) * (row.stepped ? 0.18 : 0.08);
            return [low - pad, high + pad];
          },
        },
      },
      axes: row.kind === "symbols" ? [axes(last)[0], { show: true, size: LEFT, grid: { show: false },
        ticks: { show: false }, values: () => [] }] : axes(last),
      series: [{}, ...app.tracks.map(track => ({
        stroke: theme.track(track.color), width: track === app.active ? 1.8 : 1.2,
        points: { show: false }, spanGaps: true,
        ...(row.stepped ? { paths: uPlot.paths.stepped({ align: 1 }) } : {}),
        ...(row.kind === "symbols" ? { paths: () => null } : {}),
      }))],
      hooks: { draw: row.kind === "symbols" ? [paintStrip] : [] },
    };
  }

  const strip = () => 10 + STRIP * Math.max(1, app.tracks.length);

  /** Each track's symbols as a band of their colours. */
  function paintStrip(plot) {
    const { ctx, bbox } = plot, scale = bbox.height / Math.max(1, app.tracks.length);
    app.tracks.forEach((track, row) => {
      const { symbols, t } = track;
      for (let k = 0; k < symbols.length;) {
        const from = k;
        while (k < symbols.length && symbols[k] === symbols[from]) k += 1;
        const x0 = plot.valToPos(t[from], "x", true), x1 = plot.valToPos(t[k], "x", true);
        ctx.fillStyle = app.theme.color(symbols[from]);
        ctx.fillRect(x0, bbox.top + row * scale + 1, Math.max(1, x1 - x0), scale - 2);
      }
    });
  }

  function show() {
    for (const plot of plots) plot.destroy();
    root.replaceChildren();
    root.classList.toggle("empty", !app.tracks.length);
    plots = [];
    if (!app.tracks.length) return;
    const width = root.clientWidth;
    const costly = app.tracks.some(track => track.cost.at(-1) !== 0);
    const shown = rows.filter(row => row.kind !== "cost" || costly);
    plots = shown.map((row, k) => {
      const last = k === shown.length - 1;
      const holder = element("div", { class: `plot ${row.kind}` },
        element("span", { class: "title" }, row.name));
      root.append(holder);
      const content = row.kind === "symbols"
        ? [[0, app.longest()], ...app.tracks.map(() => [0, 0])] : table(row);
      const plot = new uPlot(options(row, width, last), content, holder);
      plot.now = element("div", { class: "now" });
      plot.over.append(plot.now);
      seek(plot.over, plot);
      return plot;
    });
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
    over.addEventListener("pointerup", () => (held = false));
  }

  function sweep() {
    for (const plot of plots) {
      plot.now.style.transform = `translateX(${plot.valToPos(app.player.time, "x")}px)`;
    }
  }

  let width = 0;
  new ResizeObserver(() => {
    if (Math.abs(root.clientWidth - width) < 1) return;
    width = root.clientWidth;
    plots.forEach(plot => plot.setSize({ width, height: plot.height }));
    sweep();
  }).observe(root);

  return { show, sweep };
}
