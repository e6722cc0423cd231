import { byId } from "../dom/elements.js";
import { makeLoop } from "#page/loop/loop.js";
import { makeLookup } from "#page/policy/lookup.js";
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
 * @property {?object} loop  see `makeLoop`; null without a model
 * @property {object[]} tracks  the trajectories that are shown, see `compute` of `trajectories.js`
 * @property {?object} active  the one that all parts show
 * @property {number} started  how many were started since there was none
 * @property {?object} pointed  what is pointed at: {state (n), cell, symbol, status}. A state has
 *   the exogenous inputs after it, if there are any: it is a reading
 * @property {object} parts  what `main.js` puts on the page. None calls another: they change the
 *   state by the functions of `changes.js` and `trajectories.js`, which have the parts show it
 */

/**
 * Return the state of the page without its parts; `data` is what `page_data` makes, `model`
 * what `model_javascript` does, `features` what `features_javascript` does, if it has any.
 */
export function makeApp(data, model, features) {
  const lookup = makeLookup(data, features);
  const app = {
    data, model, lookup,
    loop: data.loops ? makeLoop(data, lookup, model) : null,
    view: new View(data, lookup.levels),
    tracks: [], active: null, started: 0, pointed: null, parts: {},
    soon: makeSoon(), note: makeNote(byId("note"), NOTED),
  };
  app.theme = makeTheme(data, () => restyle(app));
  app.player = makePlayer(() => longest(app.tracks), () => moved(app));
  return app;
}

/** Return a function that does something once before the next frame, however often it is asked. */
function makeSoon() {
  const waiting = new Set();
  return (name, action) => {
    if (waiting.has(name)) return;
    waiting.add(name);
    requestAnimationFrame(() => {
      waiting.delete(name);
      action();
    });
  };
}

/** Return a function that shows text in an element for a time [ms]. */
function makeNote(element, time) {
  let timer = null;
  return text => {
    clearTimeout(timer);
    element.textContent = text;
    timer = setTimeout(() => (element.textContent = ""), time);
  };
}
