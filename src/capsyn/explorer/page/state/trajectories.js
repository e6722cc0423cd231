import { byId } from "../dom/elements.js";
import { moved, showTracks } from "./changes.js";
import { coming, longest } from "./tracks.js";

const MOST_TRACKS = 6;

/**
 * Start a trajectory at a state, with the exogenous inputs as they are set, beside the others or in
 * their place.
 */
export function start(app, x0) {
  begin(app, app.view.told(x0), []);
}

function begin(app, x0, told) {
  if (!app.loop) return;
  const run = compute(app, x0, told);
  if (!run) return;
  const keeps = app.parts.settings.keeps();
  const dropped = keeps && app.tracks.length === MOST_TRACKS ? app.tracks[0].number : null;
  app.tracks = keeps ? app.tracks.slice(-(MOST_TRACKS - 1)) : [];
  if (!app.tracks.length) app.started = 0;
  const used = new Set(app.tracks.map(track => track.color));
  const color = [...Array(MOST_TRACKS).keys()].find(k => !used.has(k));
  app.started += 1;
  app.active = { ...run, number: app.started, color };
  app.tracks.push(app.active);
  showTracks(app);
  if (dropped) byId("status").textContent += ` · trajectory ${dropped} made room`;
  const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  app.player.pause();
  app.player.time = still ? longest(app.tracks) : 0;
  moved(app);
  if (!still) app.player.play();
}

/** Move where the active trajectory starts to another place in the plane. */
export function move(app, x0) {
  app.soon("move", () => {
    if (!app.active) return;
    const state = Array.from(app.active.start);
    for (const axis of app.view.axes) if (axis < app.view.states) state[axis] = x0[axis];
    again(app, state);
  });
}

/** Tell the active trajectory the exogenous inputs as they are set, from the next sample on. */
export function tell(app) {
  const { active, view } = app;
  if (!active || isOver(app)) return;
  const time = coming(app, active) / active.rate, values = view.fixed.slice(view.states);
  if (time === 0) again(app, view.told(active.start), []);
  else {
    const earlier = active.told.filter(([since]) => since < time);
    again(app, active.start, [...earlier, [time, values]]);
  }
}

/** Whether exogenous inputs have been set after the end of the active trajectory. */
export function waits(app) {
  const { active, view } = app;
  return Boolean(active) && isOver(app) &&
    active.states.at(-1).some((value, axis) => axis >= view.states && value !== view.fixed[axis]);
}

const isOver = app => coming(app, app.active) >= app.active.symbols.length;

/** Play on; after the end from the start, with the exogenous inputs that were set since. */
export function play(app) {
  const { active, player, tracks, view } = app;
  if (player.time >= longest(tracks) && waits(app)) again(app, view.told(active.start), []);
  player.play();
}

/** Compute the active trajectory under other settings, beside it or in its place. */
export function rerun(app) {
  if (!app.active) return;
  if (app.parts.settings.keeps()) begin(app, app.active.start, app.active.told);
  else again(app, app.active.start);
}

export function choose(app, track) {
  app.active = track;
  showTracks(app);
  moved(app);
}

export function drop(app, track) {
  app.tracks = app.tracks.filter(other => other !== track);
  if (app.active === track) app.active = app.tracks.at(-1) ?? null;
  if (!app.tracks.length) app.player.pause();
  showTracks(app);
  app.player.seek(app.player.time);
}

/** Compute the active trajectory anew: from another state, told otherwise, or set otherwise. */
function again(app, x0, told = app.active.told) {
  const run = compute(app, x0, told);
  if (!run) return;
  const next = { ...run, number: app.active.number, color: app.active.color };
  app.tracks = app.tracks.map(track => (track === app.active ? next : track));
  app.active = next;
  showTracks(app);
  app.player.time = Math.min(app.player.time, longest(app.tracks));
  moved(app);
}

/**
 * Return the trajectory from a reading under the settings; where they are wrong say so: null. It is
 * what `run` of `makeLoop` returns, its states one by one, where it was asked to start, what it
 * was `told` since, pairs [time, exogenous inputs], and `words` on what is unusual about its
 * options; on the page it gets a number, and a colour of the theme.
 */
function compute({ loop, lookup: { n }, note, parts: { settings } }, x0, told) {
  const options = settings.options();
  if (typeof options === "string") {
    byId("status").textContent = `Not computed: ${options}.`;
    note(`No trajectory: ${options}`);
    return null;
  }
  const run = loop.run(x0, { ...options, exogenous: told });
  const states = Array.from(run.t, (_, k) => run.x.subarray(k * n, (k + 1) * n));
  const words = settings.summary(options);
  return { ...run, states, options, told, start: Array.from(x0), words };
}
