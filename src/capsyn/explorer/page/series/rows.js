import { withUnit } from "../dom/text.js";

/**
 * @typedef {object} Row  A plot of the time series.
 * @property {"state"|"input"|"symbols"|"cost"} kind
 * @property {string} name
 * @property {function} [value]  value(track, k) of a curve at sample k
 * @property {function} [paint]  paint(plot) of what is no curve
 * @property {number[]} [values]  what an input may be, ascending, for its ticks
 * @property {number[]} [all]  what an input may be, with the default control
 * @property {function} [of]  of(symbol) of an input
 */

/** Return the rows of a policy: its states, its inputs, the symbols and the cost. */
export function rowsOf({ domain, alphabet, controls }, strips) {
  return [
    ...domain.names.map((name, i) => ({
      kind: "state", name: withUnit(name, domain.units[i]), value: (track, k) => track.states[k][i],
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
