import { makeAutomaton } from "./automaton.js";
import { makeMapTools, makePlayerBar, makeSettings } from "./controls.js";
import { byId, counted, element, short, tickText, unitText, whole } from "./dom.js";
import { makeDrawing } from "./drawings.js";
import { showFacts, swatch } from "./facts.js";
import { makeLookup, MIXED, NONE } from "./lookup.js";
import { makeLoop } from "./loop.js";
import { makeMap } from "./map.js";
import { makePlayer } from "./player.js";
import { makeSeries } from "./series.js";
import { makeTheme } from "./theme.js";
import { makeView } from "./view.js";

const MOST_TRACKS = 6;
/** How long a note stays over the map [ms]. */
const NOTED = 4000;
const ENDS = {
  time: "ran to the end", target: "reached the target", "left the domain": "left the domain",
  "not finite": "is no longer finite",
};

/** Bring the page to life; `model` is what `model_javascript` makes. */
export function start(model) {
  const data = JSON.parse(byId("data").textContent);
  const lookup = makeLookup(data), { names, units, periodic } = data.domain;
  const n = names.length, count = data.symbols.length - 1;
  const view = makeView(data, lookup.levels);
  const loop = data.loops ? makeLoop(data, lookup, model) : null;
  const app = { data, model, lookup, view, loop, tracks: [], active: null, pointed: null };
  let made = 0, waiting = {};

  app.theme = makeTheme(count, () => restyle());
  app.longest = () => app.tracks.reduce((most, track) => Math.max(most, track.t.at(-1)), 0);
  app.progress = track =>
    Math.min(Math.floor(app.player.time * track.rate + 1e-6), track.states.length - 1);
  app.player = makePlayer(app.longest, () => app.moved());

  /** Do something once before the next frame. */
  function soon(name, action) {
    if (waiting[name]) return;
    waiting[name] = true;
    requestAnimationFrame(() => {
      waiting[name] = false;
      action();
    });
  }

  app.changed = () => {
    tools.sync();
    document.body.classList.toggle("whole", view.level >= lookup.levels);
    reread();
    soon("map", () => map.draw());
  };
  app.moved = () => {
    bar?.sync();
    if (tools.follows() && app.active) {
      view.fixed = Array.from(app.active.states[app.progress(app.active)], view.held);
      tools.sync();
      reread();
      map.draw();
    } else map.sweep();
    series?.sweep();
    automaton.sweep();
    drawing.draw();
    trackTimes();
  };
  app.seek = time => {
    app.player.pause();
    app.player.seek(time);
  };
  app.zoomed = factor => {
    const on = app.pointed ? app.pointed.state : view.state(0.5, 0.5);
    map.zoomed(factor, on);
  };

  app.point = state => {
    if (state) read(state);
    else app.pointed = null;
    readout();
    soon("sweep", () => map.sweep());
  };

  /** What is at a state; the cell is where the state is, however often it has gone round. */
  function read(state) {
    const cell = lookup.cell(state);
    if (cell && cell.lower) {
      const turned = (edge, i) => edge + state[i] - view.wrapped(state[i], i);
      Object.assign(cell, { lower: cell.lower.map(turned), upper: cell.upper.map(turned) });
    }
    app.pointed = { state, cell, ...lookup.symbol(state) };
  }

  /** Read the place that is pointed at again: the plane or the other states have changed. */
  function reread() {
    if (app.pointed) read(view.state(...view.place(app.pointed.state)));
    readout();
  }

  let noted = null;
  /** Say something over the map for a while. */
  app.note = text => {
    clearTimeout(noted);
    byId("note").textContent = text;
    noted = setTimeout(() => (byId("note").textContent = ""), NOTED);
  };

  function compute(x0) {
    const options = settings.options();
    if (typeof options === "string") {
      byId("status").textContent = `Not computed: ${options}.`;
      app.note(`No trajectory: ${options}`);
      return null;
    }
    const run = loop.run(x0, options);
    const states = run.t.length
      ? Array.from(run.t, (_, k) => run.x.subarray(k * n, (k + 1) * n)) : [];
    return { ...run, states, options, start: Array.from(x0), words: settings.summary(options) };
  }

  app.start = x0 => {
    if (!loop) return;
    const run = compute(x0);
    if (!run) return;
    const dropped = settings.keeps() && app.tracks.length === MOST_TRACKS ? app.tracks[0].number : null;
    app.tracks = settings.keeps() ? app.tracks.slice(-(MOST_TRACKS - 1)) : [];
    if (!app.tracks.length) made = 0;
    const used = new Set(app.tracks.map(track => track.color));
    const color = [...Array(MOST_TRACKS).keys()].find(k => !used.has(k));
    made += 1;
    app.active = { ...run, number: made, color };
    app.tracks.push(app.active);
    showTracks();
    if (dropped) byId("status").textContent += ` · trajectory ${dropped} made room`;
    const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    app.player.pause();
    app.player.time = still ? app.longest() : 0;
    app.moved();
    if (!still) app.player.play();
  };

  /** Compute the active trajectory anew, from another state or under other settings. */
  function again(x0) {
    const run = compute(x0);
    if (!run) return;
    const next = { ...run, number: app.active.number, color: app.active.color };
    app.tracks = app.tracks.map(track => (track === app.active ? next : track));
    app.active = next;
    showTracks();
    app.player.time = Math.min(app.player.time, app.longest());
    app.moved();
  }
  app.move = x0 => soon("move", () => {
    if (!app.active) return;
    const state = Array.from(app.active.start);
    view.axes.forEach(axis => (state[axis] = x0[axis]));
    again(state);
  });
  app.rerun = () => {
    if (!app.active) return;
    if (settings.keeps()) app.start(app.active.start);
    else again(app.active.start);
  };

  function drop(track) {
    app.tracks = app.tracks.filter(other => other !== track);
    if (app.active === track) app.active = app.tracks.at(-1) ?? null;
    if (!app.tracks.length) app.player.pause();
    showTracks();
    app.player.seek(app.player.time);
  }

  function showTracks() {
    const status = app.active ? ended(app.active) : "Click a state on the map.";
    const focused = document.activeElement?.closest(".chip")?.dataset.number;
    byId("status").textContent = status;
    const chips = app.tracks.map(track => {
      const badge = element("span", { class: "badge" }, String(track.number));
      badge.style.setProperty("--track", app.theme.track(track.color));
      const from = track.start.map(v => short(v, 3)).join(", ");
      const chip = element("span", { class: "chip", role: "listitem", "data-number": track.number },
        element("button", { type: "button", class: "choose", title: "Make it the active one",
          "aria-pressed": String(track === app.active), onclick: () => {
            app.active = track;
            showTracks();
            app.moved();
          } },
        badge, element("span", {}, `from (${from})`),
        track.words ? element("small", {}, track.words) : null,
        element("span", { class: "cost", title: `Cost of all of it, eq. (3): ${short(track.cost.at(-1))} ` +
          `while running and ${short(track.terminalCost)} at the end` }, `J ${short(track.totalCost)}`)),
        element("button", { type: "button", class: "drop", title: "Remove",
          "aria-label": `Remove trajectory ${track.number}`, onclick: () => drop(track) }, "×"));
      chip.classList.toggle("active", track === app.active);
      return chip;
    });
    byId("tracks").replaceChildren(...chips);
    if (focused) (chips.find(chip => chip.dataset.number === focused) ?? chips.at(-1))
      ?.querySelector(".choose").focus();
    series?.show();
    bar?.sync();
  }

  function ended(track) {
    const at = short(track.t.at(-1));
    const parts = [
      `Trajectory ${track.number} ${ENDS[track.ended]}` +
        (track.ended === "time" ? ` (${at} s)` : ` at ${at} s`),
      counted(track.switches, "switch", "switches"),
      data.target && (Number.isNaN(track.arrived) ? "target not reached"
        : `target first reached at ${short(track.arrived)} s`),
      track.outside > 0 && `${counted(track.outside, "sample")} outside`,
      !loop.substeps(track.rate).resolved && "integration not resolved: raise the sample rate",
    ];
    return parts.filter(Boolean).join(" · ");
  }

  function trackTimes() {
    for (const chip of byId("tracks").children) {
      const track = app.tracks.find(one => String(one.number) === chip.dataset.number);
      if (track) chip.classList.toggle("done", app.player.time >= track.t.at(-1));
    }
  }

  function readout() {
    const at = app.pointed, rows = [];
    const row = (name, ...content) => rows.push(
      element("div", { class: name }, element("dt", {}, name), element("dd", {}, ...content)));
    const name = symbol => (symbol === NONE ? "none" : data.symbols.at(symbol));
    const value = (text, unit) => (unit ? `${text} ${unitText(unit)}` : text);
    if (!at) row("state", "point at the map, or move the cursor with the arrow keys");
    else {
      row("state", names.map((text, i) => `${text} = ${value(short(at.state[i]), units[i])}`).join(", "));
      const later = at.cell && at.cell.level > view.level, final = later ? "final " : "";
      if (later) row("then", swatch(MIXED), `still to split at level ${view.level}`);
      row("symbol", swatch(at.symbol), final, name(at.symbol), at.symbol === NONE ? "" : element("span",
        { class: "quiet" }, ` ${data.alphabet.inputs.map((text, i) =>
          `${text} = ${value(short(data.controls.at(at.symbol)[i]), data.alphabet.units[i])}`).join(", ")}`));
      const { cell } = at;
      if (cell) {
        const box = cell.lower
          ? cell.lower.map((low, i) => `[${[low, cell.upper[i]].map(tickText([low, cell.upper[i]])).join(", ")}]`).join(" × ")
          : "cut by oblique splits";
        row("allowed", ...cell.allowed.flatMap(symbol => [swatch(symbol), `${name(symbol)} `]),
          element("span", { class: "quiet" }, cell.allowed.length > 1 ? "mixed" : ""));
        row("cell", `${final}${whole(cell.leaf)}, ${data.tree ? "depth" : "level"} ${cell.level}: ${box}`);
      } else row("cell", "outside the domain");
    }
    byId("readout").replaceChildren(...rows);
    paintSwatches();
  }

  function paintSwatches() {
    for (const node of document.querySelectorAll(".swatch")) {
      const symbol = Number(node.dataset.symbol);
      node.style.background = symbol === MIXED
        ? `repeating-linear-gradient(135deg, ${app.theme.stripe} 0 2px, ${app.theme.mixed} 2px 6px)`
        : symbol === NONE ? app.theme.none : app.theme.color(symbol);
    }
  }

  function only(symbol) {
    view.only = symbol;
    soon("map", () => map.draw());
  }

  function legend() {
    const shown = [...Array(count).keys()];
    if (data.shares.at(-1) > 0) shown.push(-1);
    const entry = (mark, text, more = {}) =>
      element("span", { role: "listitem", ...more }, mark, text);
    byId("legend").replaceChildren(
      ...shown.map(symbol => element("span", { role: "listitem" }, element("button", {
        type: "button", class: "key", title: "Show only its cells", "data-symbol": symbol,
        onpointerenter: () => only(symbol), onpointerleave: () => only(null),
        onfocus: () => only(symbol), onblur: () => only(null),
      }, swatch(symbol), data.symbols.at(symbol)))));
    if (loop && data.target && n > 1) {
      byId("legend").append(
        entry(element("span", { class: "line" }), "target", { title: data.target.text }));
    }
    if (lookup.levels > 0) {
      byId("legend").append(entry(swatch(MIXED), "still to split", { class: "later" }));
    }
  }

  function restyle() {
    byId("theme").textContent = app.theme.mode === "dark" ? "Light" : "Dark";
    map.draw();
    automaton.draw();
    drawing.draw();
    showTracks();
    paintSwatches();
  }

  byId("name").textContent = data.name;
  if (!data.drawing) document.body.classList.add("undrawn");
  byId("summary").textContent = [
    counted(n, "state"),
    counted(count, "symbol"),
    data.tree ? counted((data.tree.split.shape[0] + 1) / 2, "leaf", "leaves")
      : counted(data.automaton.vertices.reduce((sum, v) => sum + v.cells, 0), "cell"),
    data.statistics.solves && counted(data.statistics.solves, "solve"),
  ].filter(Boolean).join(" · ");
  document.body.classList.toggle("flat", n === 1);
  document.body.classList.toggle("static", !loop);

  const map = makeMap(app);
  const tools = makeMapTools(app);
  const settings = loop && makeSettings(app);
  const bar = loop && makePlayerBar(app);
  const series = loop && makeSeries(app);
  const automaton = makeAutomaton(app);
  const drawing = makeDrawing(app);
  for (const id of ["player", "tracks", "series", "status", "settings"]) byId(id).hidden = !loop;
  showFacts(app);
  legend();
  app.changed();
  readout();
  restyle();

  byId("theme").addEventListener("click", () => app.theme.toggle());
  byId("keys").addEventListener("click", () => byId("help").showModal());
  const keys = {
    " ": () => bar?.toggle(), r: () => bar?.rewind(), d: () => app.theme.toggle(),
    o: () => {
      view.outlines = !view.outlines;
      app.changed();
    },
    "[": () => tools.show(view.level - 1), "]": () => tools.show(view.level + 1),
    "?": () => byId("help").showModal(),
  };
  document.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey || byId("help").open) return;
    const own = event.target.closest("input, select, button, textarea");
    const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action || own && (event.key === " " || own.type === "number" || own.tagName === "SELECT")) return;
    event.preventDefault();
    action();
  });
  new ResizeObserver(() => soon("map", () => map.draw())).observe(byId("map-box"));

  if (loop) app.start(view.state(...view.axes.map(axis => (periodic[axis] ? 0.5 : 0.62))));

  /** What the page shows, for those who want to check it; reading it changes nothing. */
  window.capsyn = Object.freeze({
    state: () => ({
      axes: [...view.axes], bounds: [...view.bounds], fixed: [...view.fixed], level: view.level,
      outlines: view.outlines, theme: app.theme.mode, time: app.player.time,
      playing: app.player.playing, speed: app.player.speed, frame: map.shown().frame,
      only: view.only, colors: app.theme.symbols,
      pointed: app.pointed && { state: Array.from(app.pointed.state), symbol: app.pointed.symbol },
      tracks: app.tracks.map(track => ({
        number: track.number, start: track.start, end: Array.from(track.states.at(-1)),
        samples: track.symbols.length, switches: track.switches, ended: track.ended,
        cost: track.totalCost, rate: track.rate, active: track === app.active,
        now: Array.from(track.states[app.progress(track)]),
      })),
      taken: automaton.taken(),
    }),
    redraw: map.redraw,
    map: map.shown,
    series: () => (series ? series.shown() : []),
  });
}
