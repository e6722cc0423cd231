import { withUnit } from "../dom/text.js";

/**
 * Return the rows of a policy: its states, its inputs, the symbols and the cost. A curve has
 * `value(track, k)` at sample k, others `paint(plot)`; an input has the `values` that it may have,
 * ascending, for its ticks, `all` with the default control, and `of(symbol)`.
 */
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
