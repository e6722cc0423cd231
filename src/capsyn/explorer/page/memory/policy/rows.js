import { CellTree } from "../../policy/cell_tree.js";
import { unpack } from "../../policy/packed.js";
import { SplitTree } from "../../policy/split_tree.js";

/**
 * Return the cells of a policy that remembers, whose leaf numbers are rows of transitions: as
 * `CellTree` or `SplitTree`, but for
 *
 * - `label(place, z, now)`: the label that follows `now`; labels are symbols, the default last;
 * - `row(place, z)`: what follows each label, (N + 1);
 * - `constant(place)`: whether that is the same for all lattice steps of a leaf;
 * - `isMixed(place)`: whether several rows were seen in a cell, or vary in it;
 * - `allowed(place)`: the labels that were seen in a cell, or follow any label there;
 * - `remembers`: whether what follows depends on the label in force anywhere.
 */
export function cellsOfRows({ tree, cells: packed, controls, memory }, n, ranks) {
  const labels = controls.length, table = unpack(memory.transitions);
  const first = labels + table.length / labels, priced = makePriced(packed, labels);
  const cells = tree ? new SplitTree(tree, n, ranks) : new CellTree(packed, first);
  const base = Object.getPrototypeOf(cells);
  const constant = place => Boolean(tree) || -1 - cells.entries[place] < first;

  function label(place, z, now) {
    if (priced && !constant(place)) return priced(cells, -1 - cells.entries[place], z, now);
    const row = base.label.call(cells, place, z);
    return row < labels ? row : table[(row - labels) * labels + now];
  }

  function allowed(place) {
    const seen = base.allowed.call(cells, place).flatMap(row => (row < labels ? row
      : Array.from(table.subarray((row - labels) * labels, (row - labels + 1) * labels))));
    return [...new Set(seen)].sort((a, b) => a - b);
  }

  const several = tree ? [] : cells.mixed;
  const isMixed = place => !constant(place) || several.includes(place);
  const row = (place, z) => controls.map((_, now) => label(place, z, now));
  const remembers = first > labels || priced !== null;
  return Object.assign(cells, { label, row, constant, allowed, remembers, isMixed });
}

/**
 * Return what gives the label that follows another in an affine leaf with prices: that of the
 * largest row, less its price; of equals that in force, then the first. Null without prices.
 */
function makePriced(packed, labels) {
  if (!packed?.row_prices) return null;
  const prices = unpack(packed.row_prices), ratios = unpack(packed.row_ratios);
  return (cells, leaf, z, now) => {
    const { symbols, constants, slopes } = cells.rows, [start, end] = cells.rowsOf(leaf);
    const price = prices[leaf - cells.labels];
    let best = now, most = -Infinity;
    for (let row = start; row < end; row++) {
      const symbol = symbols[row], ratio = ratios[now * labels + symbol];
      if (ratio < 0) continue;
      let value = constants[row] - price * ratio;
      for (let i = 0; i < z.length; i++) value += slopes[row * z.length + i] * z[i];
      if (value > most || (value === most && symbol === now)) [best, most] = [symbol, value];
    }
    return best;
  };
}
