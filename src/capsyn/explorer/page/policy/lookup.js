import { CellTree } from "./cell_tree.js";
import { Domain } from "./domain.js";
import { makeRanks } from "./features.js";
import { raster } from "./raster.js";
import { SplitTree } from "./split_tree.js";
import { DEFAULT, INSIDE, MIXED, NONE, OUTSIDE } from "./symbols.js";

/**
 * Return the lookup of a policy from its `policy_data`: {n, levels, symbol, cell, raster, places}.
 * `features` is what `features_javascript` makes; null where there are none.
 *
 * symbol(x, outside): {symbol, status} of a state; `outside` is "error", "nearest" or a symbol, and
 * the policy's own rule unless given. The symbol is NONE where Python's policy raises an error.
 *
 * cell(x): the cell of a state in the domain, {leaf, level, lower, upper, symbol, allowed}, else
 * null: its place in the arrays, its level (of a decision tree the comparisons that led to it), its
 * corners (null where an oblique split or a feature cuts it), the state's symbol and those seen in
 * it.
 *
 * raster({axes: [i, j], fixed, bounds: [x0, x1, y0, y1], width, height, level}): the symbols at the
 * centres of pixels, row by row from y1 down, Int16Array. The other states have their values of
 * `fixed`; NONE is outside the domain. Cells deeper than `level` (default: none) are MIXED, as
 * Algorithm 1 saw them then. Decision trees have no levels.
 *
 * places(the same): the places of the cells in the arrays, Int32Array; NONE outside the domain.
 */
export function makeLookup(data, features = null) {
  const domain = new Domain(data.domain, data.counts), last = data.controls.length - 1;
  const ranks = makeRanks(data.features, features);
  const cells = data.tree
    ? new SplitTree(data.tree, domain.n, ranks) : new CellTree(data.cells, last + 1);
  const symbolOf = label => (label === last ? DEFAULT : label);
  const pixelOf = (place, whole, z) => (whole ? symbolOf(cells.label(place, z)) : MIXED);

  function symbol(x, outside = data.outside) {
    const status = domain.status(x);
    if (status === INSIDE || (status === OUTSIDE && outside === "nearest")) {
      const z = domain.steps(x);
      return { symbol: symbolOf(cells.label(cells.find(z), z)), status };
    }
    return { symbol: typeof outside === "number" ? outside : NONE, status };
  }

  function cell(x) {
    if (domain.status(x) !== INSIDE) return null;
    const z = domain.steps(x), { place, level, low, high } = cells.cell(z, data.counts);
    return {
      leaf: place,
      level,
      lower: low && low.map((k, i) => domain.face(i, k)),
      upper: high && high.map((k, i) => domain.face(i, k)),
      symbol: symbolOf(cells.label(place, z)),
      allowed: cells.allowed(place).map(symbolOf),
    };
  }

  return {
    n: domain.n,
    levels: cells.levels,
    symbol,
    cell,
    raster: plane => raster(domain, cells, plane, Int16Array, pixelOf),
    places: plane => raster(domain, cells, plane, Int32Array, place => place),
  };
}
