import { makeAutomaton } from "#page/automaton/automaton.js";
import { listenToKeys } from "./controls/keys.js";
import { makeMapTools } from "#page/controls/map_tools.js";
import { makePlayerBar } from "./controls/player_bar.js";
import { makeSettings } from "#page/controls/settings.js";
import { byId } from "./dom/elements.js";
import { makeDrawing } from "./drawing/drawing.js";
import { makeMap } from "./map/map.js";
import { makeChips } from "#page/panels/chips.js";
import { showFacts, showLegend, showTitle } from "./panels/facts.js";
import { makeReadout } from "#page/panels/readout.js";
import { unpacked } from "./policy/packed.js";
import { makeSeries } from "./series/series.js";
import { makeApp } from "./state/app.js";
import { changed, drawSoon, restyle } from "./state/changes.js";
import { progress } from "./state/tracks.js";
import { start as startTrajectory } from "./state/trajectories.js";

/** Bring the page to life; for the arguments see `makeApp`. */
export async function start(model, features) {
  const packed = byId("data");
  const app = makeApp(await unpacked(packed.textContent), model, features), { data, loop, view } = app;
  packed.remove();
  showTitle(app);
  app.parts = {
    map: makeMap(app),
    tools: makeMapTools(app),
    settings: loop && makeSettings(app),
    bar: loop && makePlayerBar(app),
    series: loop && makeSeries(app),
    automaton: makeAutomaton(app),
    drawing: makeDrawing(app),
    chips: makeChips(app),
    readout: makeReadout(app),
  };
  showFacts(app);
  showLegend(app);
  changed(app);
  restyle(app);
  listenToKeys(app);
  new ResizeObserver(() => drawSoon(app)).observe(byId("map-box"));
  if (loop) {
    const shares = view.axes.map(axis => (data.domain.periodic[axis] ? 0.5 : 0.62));
    startTrajectory(app, view.state(...shares));
  }
  window.capsyn = report(app);
}

/** What the page shows, for those who want to check it; reading it changes nothing. */
function report(app) {
  const { view, theme, player, parts: { map, series, automaton } } = app;
  return Object.freeze({
    state: () => ({
      axes: [...view.axes], bounds: [...view.bounds], fixed: [...view.fixed], level: view.level,
      outlines: view.outlines, proved: view.proved, theme: theme.mode, time: player.time,
      playing: player.playing, speed: player.speed, frame: map.shown().frame,
      only: view.only, colors: theme.symbols,
      pointed: app.pointed && { state: Array.from(app.pointed.state), symbol: app.pointed.symbol },
      tracks: app.tracks.map(track => ({
        number: track.number, start: track.start, end: Array.from(track.states.at(-1)),
        samples: track.symbols.length, switches: track.switches, ended: track.ended,
        cost: track.totalCost, rate: track.rate, active: track === app.active,
        now: Array.from(track.states[progress(app, track)]),
      })),
      taken: automaton.taken(),
    }),
    redraw: map.redraw,
    map: map.shown,
    series: () => (series ? series.shown() : []),
  });
}
