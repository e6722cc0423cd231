import { unpack } from "./packed.js";
import { fill } from "./raster.js";

/** A decision tree; see `capsyn.cells.split_tree.SplitTree` for the arrays. */
export class SplitTree {
  constructor(packed, n, ranks) {
    const names = ["split", "threshold", "second", "planes"];
    for (const name of names) this[name] = Int32Array.from(unpack(packed[name]));
    this.n = n;
    /** Features, see `makeRanks`; their ranks come after the steps. */
    this.ranks = ranks;
    this.width = n + ranks.count;
    /** There is nothing to replay. */
    this.levels = 0;
  }

  /** What a node compares with its threshold, of lattice steps with ranks. */
  compared(node, places) {
    const { split, planes, width } = this;
    if (split[node] < width) return places[split[node]];
    const row = (split[node] - width) * width;
    let sum = 0;
    for (let i = 0; i < width; i++) sum += planes[row + i] * places[i];
    return sum;
  }

  /** Lattice steps with the ranks of features after them. */
  withRanks(z) {
    return this.ranks.count ? [...z, ...this.ranks.at(z)] : z;
  }

  find(z) {
    const { split, threshold, second } = this, places = this.withRanks(z);
    let node = 0;
    while (split[node] >= 0) {
      node = this.compared(node, places) >= threshold[node] ? second[node] : node + 1;
    }
    return node;
  }

  label(node) {
    return this.threshold[node];
  }

  allowed(node) {
    return [this.threshold[node]];
  }

  /** The leaf with lattice steps z: {place, level, low, high}, in steps. */
  cell(z, counts) {
    const { split, threshold, second } = this, low = z.map(() => 0), high = Array.from(counts);
    const places = this.withRanks(z);
    let node = 0, level = 0, oblique = false;
    for (; split[node] >= 0; level++) {
      const axis = split[node], beyond = this.compared(node, places) >= threshold[node];
      if (axis >= this.n) oblique = true;
      else if (beyond) low[axis] = Math.max(low[axis], threshold[node]);
      else high[axis] = Math.min(high[axis], threshold[node]);
      node = beyond ? second[node] : node + 1;
    }
    return { place: node, level, low: oblique ? null : low, high: oblique ? null : high };
  }

  /** Return `value(node, true)` of the leaves of a plane; see `CellTree`. */
  section(plane) {
    if (this.ranks.count) return this.everyStep(plane);
    const { z, i, j, columns, rows, value } = plane;
    const { split, threshold, second, planes } = this;
    const across = columns.length, grid = new Int32Array(across * rows.length);
    const origin = z.map((k, axis) => (axis === i || axis === j ? 0 : k));

    /** Fill the part [a0, a1) x [b0, b1) of the grid from a node. */
    const go = (node, a0, a1, b0, b1) => {
      while (a0 < a1 && b0 < b1) {
        const axis = split[node], cut = threshold[node];
        if (axis < 0) return fill(grid, across, value(node, true), a0, a1, b0, b1);
        let beyond = true;
        if (axis === i) {
          const middle = before(columns, a0, a1, cut);
          go(node + 1, a0, middle, b0, b1);
          a0 = middle;
        } else if (axis === j) {
          const middle = before(rows, b0, b1, cut);
          go(node + 1, a0, a1, b0, middle);
          b0 = middle;
        } else if (axis < this.n) beyond = origin[axis] >= cut;
        else {
          const row = (axis - this.n) * this.n, p = planes[row + i], q = planes[row + j];
          const base = this.compared(node, origin);
          const [xa, xb] = [p * columns[a0], p * columns[a1 - 1]];
          const [ya, yb] = [q * rows[b0], q * rows[b1 - 1]];
          if (base + Math.max(xa, xb) + Math.max(ya, yb) < cut) beyond = false;
          else if (base + Math.min(xa, xb) + Math.min(ya, yb) < cut) {
            const wide = a1 - a0 > b1 - b0, a = (a0 + a1) >> 1, b = (b0 + b1) >> 1;
            go(node, a0, wide ? a : a1, b0, wide ? b1 : b);
            if (wide) a0 = a;
            else b0 = b;
            continue;
          }
        }
        node = beyond ? second[node] : node + 1;
      }
    };
    go(0, 0, across, 0, rows.length);
    return grid;
  }

  /** The same where features bound leaves: step by step. */
  everyStep({ z, i, j, columns, rows, value }) {
    const grid = new Int32Array(columns.length * rows.length), at = Array.from(z);
    rows.forEach((row, b) => columns.forEach((column, a) => {
      at[i] = column;
      at[j] = row;
      grid[b * columns.length + a] = value(this.find(at), true);
    }));
    return grid;
  }
}

/** The first of ascending steps [from, to) that is not before a cut; `to` if all are. */
function before(steps, from, to, cut) {
  while (from < to && steps[from] < cut) from += 1;
  return from;
}
