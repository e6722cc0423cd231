import { byId } from "../dom/elements.js";
import { makeNote, makeSoon } from "../dom/later.js";
import { makeLoop } from "../loop/loop.js";
import { makeLookup } from "../policy/lookup.js";
import { moved, restyle } from "./changes.js";
import { makePlayer } from "./player.js";
import { makeTheme } from "./theme.js";
import { longest } from "./tracks.js";
import { View } from "./view.js";

/** How long a note stays over the map [ms]. */
const NOTED = 4000;

/**
 * @typedef {object} App  The page: what it is of, what it shows, and its parts.
 * @property {object} data  what `page_data` gives
 * @property {?object} model  what `model_javascript` gives
 * @property {object} lookup  see `makeLookup`
 * @property {?object} loop  see `makeLoop`; null without a model
 * @property {View} view  the plane of the map
 * @property {object} theme  see `makeTheme`
 * @property {object} player  see `makePlayer`
 * @property {Track[]} tracks  the trajectories that are shown, see `tracks.js`
 * @property {?Track} active  the one that all parts show
 * @property {number} started  how many were started since there was none
 * @property {?Pointed} pointed  what is pointed at, see `pointing.js`
 * @property {function} soon  soon(name, action), see `makeSoon`
 * @property {function} note  note(text) says something over the map for a while
 * @property {Parts} parts  what is on the page; filled in when it starts
 *
 * @typedef {object} Parts  The parts of the page. None calls another: they change the state by the
 * functions of `changes.js`, `pointing.js` and `trajectories.js`, which have the parts show it.
 * @property {object} map  {draw, sweep, redraw, shown}
 * @property {object} tools  {sync, show, follows}, over the map
 * @property {object} automaton  {draw, sweep, taken}
 * @property {object} drawing  {draw}
 * @property {object} chips  {draw, sweep}, the tracks in words
 * @property {object} readout  {draw}
 * @property {?object} settings  {options, summary, keeps}; null without a model, as all below
 * @property {?object} bar  {sync, toggle, rewind}, of the player
 * @property {?object} series  {show, sweep, shown}
 */

/** Return the state of the page without its parts; `model` is what `model_javascript` makes. */
export function makeApp(model) {
  const data = JSON.parse(byId("data").textContent), lookup = makeLookup(data);
  const app = {
    data, model, lookup,
    loop: data.loops ? makeLoop(data, lookup, model) : null,
    view: new View(data, lookup.levels),
    tracks: [], active: null, started: 0, pointed: null, parts: {},
    soon: makeSoon(), note: makeNote(byId("note"), NOTED),
  };
  app.theme = makeTheme(data.symbols.length - 1, data.palette, () => restyle(app));
  app.player = makePlayer(() => longest(app.tracks), () => moved(app));
  return app;
}
