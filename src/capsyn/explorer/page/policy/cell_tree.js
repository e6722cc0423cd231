import { regrouped, unpack } from "./packed.js";
import { fill } from "./raster.js";

/** A grid of trees; see `capsyn.cells.cell_tree.CellTree` for the arrays. */
export class CellTree {
  /** Of a policy with so many labels: leaves beyond these are affine. */
  constructor({ partitions, refinement, max_level: maxLevel, ...packed }, labels) {
    const symbols = packed.row_symbols && unpack(packed.row_symbols);
    Object.assign(this, {
      partitions, refinement,
      entries: Int32Array.from(unpack(packed.entries)),
      mixed: unpack(packed.mixed_cells), words: unpack(packed.mixed_labels),
      perCell: packed.mixed_labels.shape[1],
      splits: packed.splits ? Uint16Array.from(unpack(packed.splits)) : null,
      rootSize: refinement.map(r => r ** maxLevel),
      labels,
      rows: packed.row_starts ? {
        starts: unpack(packed.row_starts), symbols,
        constants: regrouped(unpack(packed.row_constants), symbols),
        slopes: regrouped(unpack(packed.row_slopes), symbols),
      } : null,
    });
    /** The most times that a cell is split. */
    this.levels = this.splits || this.rows ? this.deepest() : maxLevel;
  }

  /** The axes that a cell is split along, as a bit mask. */
  axes(place) {
    return this.splits ? this.splits[place] : -1;
  }

  /** The parts along each axis into which cells are split along some. */
  parts(axes) {
    if (!this.splits) return this.refinement;
    return this.refinement.map((r, axis) => ((axes >> axis) & 1 ? r : 1));
  }

  /** The cell with lattice steps z: {place, level, size}. */
  descend(z) {
    const { entries, partitions } = this;
    let level = 0, place = 0, size = this.rootSize;
    for (let i = 0; i < z.length; i++) place = place * partitions[i] + Math.floor(z[i] / size[i]);
    for (; entries[place] >= 0; level++) {
      const parts = this.parts(this.axes(place));
      let child = 0;
      size = size.map((s, i) => s / parts[i]);
      for (let i = 0; i < z.length; i++) {
        child = child * parts[i] + (Math.floor(z[i] / size[i]) % parts[i]);
      }
      place = entries[place] + child;
    }
    return { place, level, size };
  }

  deepest() {
    const { entries } = this, levels = new Uint16Array(entries.length);
    for (let place = 0; place < entries.length; place++) {
      if (entries[place] < 0) continue;
      const children = this.parts(this.axes(place)).reduce((k, r) => k * r, 1);
      levels.fill(levels[place] + 1, entries[place], entries[place] + children);
    }
    return levels.reduce((most, level) => Math.max(most, level), 0);
  }

  find(z) {
    return this.descend(z).place;
  }

  /** The label of lattice steps z in a leaf: of its rows the first of the largest. */
  label(place, z) {
    const leaf = -1 - this.entries[place];
    if (leaf < this.labels) return leaf;
    const { symbols, constants, slopes } = this.rows, [start, end] = this.rowsOf(leaf);
    let best = symbols[start], most = -Infinity;
    for (let row = start; row < end; row++) {
      let value = constants[row];
      for (let i = 0; i < z.length; i++) value += slopes[row * z.length + i] * z[i];
      if (value > most) {
        most = value;
        best = symbols[row];
      }
    }
    return best;
  }

  /** The first row of an affine leaf, and that of the next. */
  rowsOf(leaf) {
    const at = leaf - this.labels;
    return [this.rows.starts[at], this.rows.starts[at + 1]];
  }

  /** The cell with lattice steps z: {place, level, low, high}, in steps. */
  cell(z) {
    const { place, level, size } = this.descend(z);
    const low = z.map((k, i) => k - (k % size[i]));
    return { place, level, low, high: low.map((k, i) => k + size[i]) };
  }

  /** The labels that were seen in a cell. */
  allowed(place) {
    const { mixed, words, perCell } = this, bits = 8 * words.BYTES_PER_ELEMENT;
    let first = 0, last = mixed.length;
    while (first < last) {
      const middle = (first + last) >> 1;
      if (mixed[middle] < place) first = middle + 1;
      else last = middle;
    }
    if (mixed[first] !== place) {
      const leaf = -1 - this.entries[place];
      return leaf < this.labels ? [leaf] : [...this.rows.symbols.slice(...this.rowsOf(leaf))];
    }
    const seen = [];
    for (let b = 0; b < perCell * bits; b++) {
      if ((words[first * perCell + Math.floor(b / bits)] >>> b % bits) & 1) seen.push(b);
    }
    return seen;
  }

  /**
   * Return `value(place, whole, z)` of the cells of a plane, row by row: `columns` and `rows` are
   * steps of its axes i and j, z has those of the others. Cells deeper than `depth` are not looked
   * into. Of affine leaves it is asked at every step.
   */
  section({ z, i, j, columns, rows, depth, value }) {
    const { entries } = this, across = columns.length, grid = new Int32Array(across * rows.length);
    const affine = -1 - this.labels;

    /** Fill the part [a0, a1) x [b0, b1) of the grid, in an affine leaf. */
    const each = (place, a0, a1, b0, b1) => {
      const at = z.slice();
      for (let b = b0; b < b1; b++) {
        at[j] = rows[b];
        for (let a = a0; a < a1; a++) {
          at[i] = columns[a];
          grid[b * across + a] = value(place, true, at);
        }
      }
    };

    /** Fill the part [a0, a1) x [b0, b1) of the grid, cell by cell of a block from `start`. */
    const go = (start, level, size, bases, a0, a1, b0, b1) => {
      const digit = (axis, k) => Math.floor(k / size[axis]) % bases[axis];
      let right = 0, up = 0, first = start;
      for (let axis = z.length - 1, stride = 1; axis >= 0; stride *= bases[axis], axis--) {
        if (axis === i) right = stride;
        else if (axis === j) up = stride;
        else first += digit(axis, z[axis]) * stride;
      }
      for (let b = b0; b < b1;) {
        const y = digit(j, rows[b]), low = b;
        while (b < b1 && digit(j, rows[b]) === y) b += 1;
        for (let a = a0; a < a1;) {
          const x = digit(i, columns[a]), left = a;
          while (a < a1 && digit(i, columns[a]) === x) a += 1;
          const place = first + x * right + y * up, whole = entries[place] < 0;
          if (entries[place] <= affine) each(place, left, a, low, b);
          else if (whole || level >= depth) fill(grid, across, value(place, whole), left, a, low, b);
          else {
            const parts = this.parts(this.axes(place));
            go(entries[place], level + 1, size.map((s, k) => s / parts[k]), parts, left, a, low, b);
          }
        }
      }
    };
    go(0, 0, this.rootSize, this.partitions, 0, across, 0, rows.length);
    return grid;
  }
}
