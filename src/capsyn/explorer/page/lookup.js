import { latticeStep } from "../../exports/javascript/lattice.js";

/** Symbols beside 0 .. N-1: the default control, none, and a cell that is cut further. */
export const DEFAULT = -1, NONE = -2, MIXED = -3;
/** Statuses of a state: in the domain, outside it, or with a NaN or infinite component. */
export const INSIDE = 0, OUTSIDE = 1, NOT_FINITE = 2;

const ARRAYS = {
  int8: Int8Array, uint8: Uint8Array, int16: Int16Array, uint16: Uint16Array,
  int32: Int32Array, uint32: Uint32Array, float64: Float64Array,
};

/** Return the typed array that `policy_data` packed, little-endian. */
export function unpack({ dtype, base64 }) {
  const text = atob(base64), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return new ARRAYS[dtype](bytes.buffer);
}

/**
 * Return the lookup of a policy from its `policy_data`: {n, levels, symbol, cell, raster, places}.
 *
 * symbol(x, outside): {symbol, status} of a state; `outside` is "error", "nearest" or a symbol, and
 * the policy's own rule unless given. The symbol is NONE where Python's policy raises an error.
 *
 * cell(x): the cell of a state in the domain, {leaf, level, lower, upper, symbol, allowed}, else
 * null: its place in the arrays, its level (of a decision tree the comparisons that led to it), its
 * corners (null where an oblique split cuts it), its symbol and the symbols seen in it.
 *
 * raster({axes: [i, j], fixed, bounds: [x0, x1, y0, y1], width, height, level}): the symbols at the
 * centres of pixels, row by row from y1 down, Int16Array. The other states have their values of
 * `fixed`; NONE is outside the domain. Cells deeper than `level` (default: none) are MIXED, as
 * Algorithm 1 saw them then. Decision trees have no levels.
 *
 * places(the same): the places of the cells in the arrays, Int32Array; NONE outside the domain.
 */
export function makeLookup(data) {
  const { lower, upper, periodic } = data.domain;
  const n = lower.length, labels = data.controls.length;
  const cells = data.tree ? splitTree(data.tree, n) : cellTree(data.cells);
  const { counts } = data;

  const symbolOf = label => (label === labels - 1 ? DEFAULT : label);
  const holds = (i, x) => periodic[i] || (x >= lower[i] && x <= upper[i]);
  const face = (i, k) =>
    k >= counts[i] ? upper[i] : lower[i] + (upper[i] - lower[i]) * (k / counts[i]);

  function stepsOf(x) {
    const z = new Array(n);
    for (let i = 0; i < n; i++) {
      z[i] = latticeStep(x[i], lower[i], upper[i], periodic[i], counts[i]);
    }
    return z;
  }

  function statusOf(x) {
    let status = INSIDE;
    for (let i = 0; i < n; i++) {
      if (!Number.isFinite(x[i])) return NOT_FINITE;
      if (!holds(i, x[i])) status = OUTSIDE;
    }
    return status;
  }

  function symbol(x, outside = data.outside) {
    const status = statusOf(x);
    if (status === INSIDE || (status === OUTSIDE && outside === "nearest")) {
      return { symbol: symbolOf(cells.label(cells.find(stepsOf(x)))), status };
    }
    return { symbol: typeof outside === "number" ? outside : NONE, status };
  }

  function cell(x) {
    if (statusOf(x) !== INSIDE) return null;
    const { place, level, low, high } = cells.cell(stepsOf(x), counts);
    return {
      leaf: place,
      level,
      lower: low && low.map((k, i) => face(i, k)),
      upper: high && high.map((k, i) => face(i, k)),
      symbol: symbolOf(cells.label(place)),
      allowed: cells.allowed(place).map(symbolOf),
    };
  }

  /** The steps of `size` points along an axis: which there are, ascending, and each point's, or -1. */
  function along(axis, size, position) {
    const steps = new Int32Array(size);
    for (let p = 0; p < size; p++) {
      const x = position(p);
      steps[p] = holds(axis, x)
        ? latticeStep(x, lower[axis], upper[axis], periodic[axis], counts[axis]) : -1;
    }
    const found = [...new Set(steps)].filter(k => k >= 0).sort((a, b) => a - b);
    const order = new Map(found.map((k, index) => [k, index]));
    return { found, index: steps.map(k => (k < 0 ? -1 : order.get(k))) };
  }

  function plane(Pixels, view, value) {
    const { axes: [i, j], fixed, bounds: [x0, x1, y0, y1], width, height, level } = view;
    const columns = along(i, width, p => x0 + ((p + 0.5) / width) * (x1 - x0));
    const rows = along(j, height, p => y1 - ((p + 0.5) / height) * (y1 - y0));
    const pixels = new Pixels(width * height).fill(NONE);
    const z = Array.from(fixed);
    z[i] = lower[i];
    z[j] = lower[j];
    if (statusOf(z) !== INSIDE || !columns.found.length || !rows.found.length) return pixels;
    const depth = level === undefined || level === null ? Infinity : level;
    const grid = cells.section(stepsOf(z), i, j, columns.found, rows.found, depth, value);
    const across = columns.found.length;
    for (let r = 0, start = 0; r < height; r++, start += width) {
      const row = rows.index[r];
      if (row < 0) continue;
      if (r && rows.index[r - 1] === row) {
        pixels.copyWithin(start, start - width, start);
        continue;
      }
      for (let c = 0; c < width; c++) {
        const column = columns.index[c];
        if (column >= 0) pixels[start + c] = grid[row * across + column];
      }
    }
    return pixels;
  }

  return {
    n,
    levels: cells.levels,
    symbol,
    cell,
    raster: view => plane(
      Int16Array, view, (place, whole) => (whole ? symbolOf(cells.label(place)) : MIXED)),
    places: view => plane(Int32Array, view, place => place),
  };
}

function fill(grid, across, value, a0, a1, b0, b1) {
  for (let b = b0; b < b1; b++) grid.fill(value, b * across + a0, b * across + a1);
}

/** A grid of trees; see `capsyn.cells.CellTree` for the arrays. */
function cellTree({ partitions, refinement, max_level: maxLevel, ...packed }) {
  const entries = Int32Array.from(unpack(packed.entries));
  const mixed = unpack(packed.mixed_cells), words = unpack(packed.mixed_labels);
  const perCell = packed.mixed_labels.shape[1], bits = 8 * words.BYTES_PER_ELEMENT;
  const n = partitions.length;
  const splits = packed.splits ? Uint16Array.from(unpack(packed.splits)) : null;
  const rootSize = refinement.map(r => r ** maxLevel);

  /** The axes that a cell is split along, as a bit mask. */
  const axesOf = place => (splits ? splits[place] : -1);
  const isSplit = (axes, axis) => (axes >> axis) & 1;
  const below = (size, axes) =>
    size.map((s, axis) => (isSplit(axes, axis) ? s / refinement[axis] : s));

  function descend(z) {
    let level = 0, place = 0, size = rootSize;
    for (let i = 0; i < n; i++) place = place * partitions[i] + Math.floor(z[i] / size[i]);
    for (; entries[place] >= 0; level++) {
      const axes = axesOf(place);
      let child = 0;
      size = below(size, axes);
      for (let i = 0; i < n; i++) {
        if (!isSplit(axes, i)) continue;
        child = child * refinement[i] + (Math.floor(z[i] / size[i]) % refinement[i]);
      }
      place = entries[place] + child;
    }
    return { place, level, size };
  }

  /** The most times that a cell is split. */
  function deepest() {
    const levels = new Uint16Array(entries.length);
    for (let place = 0; place < entries.length; place++) {
      if (entries[place] < 0) continue;
      const axes = axesOf(place);
      const children = refinement.reduce((k, r, axis) => (isSplit(axes, axis) ? k * r : k), 1);
      levels.fill(levels[place] + 1, entries[place], entries[place] + children);
    }
    return levels.reduce((most, level) => Math.max(most, level), 0);
  }

  return {
    levels: splits ? deepest() : maxLevel,
    find: z => descend(z).place,
    label: place => -1 - entries[place],

    cell(z) {
      const { place, level, size } = descend(z);
      const low = z.map((k, i) => k - (k % size[i]));
      return { place, level, low, high: low.map((k, i) => k + size[i]) };
    },

    allowed(place) {
      let first = 0, last = mixed.length;
      while (first < last) {
        const middle = (first + last) >> 1;
        if (mixed[middle] < place) first = middle + 1;
        else last = middle;
      }
      if (mixed[first] !== place) return [-1 - entries[place]];
      const seen = [];
      for (let b = 0; b < perCell * bits; b++) {
        if ((words[first * perCell + Math.floor(b / bits)] >>> b % bits) & 1) seen.push(b);
      }
      return seen;
    },

    section(z, i, j, columns, rows, depth, value) {
      const across = columns.length, grid = new Int32Array(across * rows.length);
      const origin = z.map((k, axis) => (axis === i || axis === j ? 0 : k));

      /** Fill the part [a0, a1) x [b0, b1) of the grid, cell by cell of a block from `start`. */
      function go(start, level, size, bases, a0, a1, b0, b1) {
        const digit = (axis, k) => Math.floor(k / size[axis]) % bases[axis];
        let right = 0, up = 0, first = start;
        for (let axis = n - 1, stride = 1; axis >= 0; stride *= bases[axis], axis--) {
          if (axis === i) right = stride;
          else if (axis === j) up = stride;
          else first += digit(axis, origin[axis]) * stride;
        }
        for (let b = b0; b < b1;) {
          const y = digit(j, rows[b]), low = b;
          while (b < b1 && digit(j, rows[b]) === y) b += 1;
          for (let a = a0; a < a1;) {
            const x = digit(i, columns[a]), left = a;
            while (a < a1 && digit(i, columns[a]) === x) a += 1;
            const place = first + x * right + y * up;
            const whole = entries[place] < 0;
            if (whole || level >= depth) fill(grid, across, value(place, whole), left, a, low, b);
            else {
              const axes = axesOf(place);
              const inner = refinement.map((r, axis) => (isSplit(axes, axis) ? r : 1));
              go(entries[place], level + 1, below(size, axes), inner, left, a, low, b);
            }
          }
        }
      }
      go(0, 0, rootSize, partitions, 0, across, 0, rows.length);
      return grid;
    },
  };
}

/** A decision tree; see `capsyn.split_tree.SplitTree` for the arrays. */
function splitTree(packed, n) {
  const [split, threshold, second, planes] =
    ["split", "threshold", "second", "planes"].map(name => Int32Array.from(unpack(packed[name])));

  function compared(node, z) {
    if (split[node] < n) return z[split[node]];
    const row = (split[node] - n) * n;
    let sum = 0;
    for (let i = 0; i < n; i++) sum += planes[row + i] * z[i];
    return sum;
  }

  function find(z) {
    let node = 0;
    while (split[node] >= 0) node = compared(node, z) >= threshold[node] ? second[node] : node + 1;
    return node;
  }

  return {
    levels: 0,
    find,
    label: node => threshold[node],
    allowed: node => [threshold[node]],

    cell(z, counts) {
      const low = z.map(() => 0), high = Array.from(counts);
      let node = 0, level = 0, oblique = false;
      for (; split[node] >= 0; level++) {
        const axis = split[node], beyond = compared(node, z) >= threshold[node];
        if (axis >= n) oblique = true;
        else if (beyond) low[axis] = Math.max(low[axis], threshold[node]);
        else high[axis] = Math.min(high[axis], threshold[node]);
        node = beyond ? second[node] : node + 1;
      }
      return { place: node, level, low: oblique ? null : low, high: oblique ? null : high };
    },

    section(z, i, j, columns, rows, depth, value) {
      const across = columns.length, grid = new Int32Array(across * rows.length);
      const origin = z.map((k, axis) => (axis === i || axis === j ? 0 : k));
      const before = (steps, from, to, cut) => {
        while (from < to && steps[from] < cut) from += 1;
        return from;
      };

      /** Fill the part [a0, a1) x [b0, b1) of the grid from a node. */
      function go(node, a0, a1, b0, b1) {
        while (a0 < a1 && b0 < b1) {
          const axis = split[node], cut = threshold[node];
          if (axis < 0) return fill(grid, across, value(node, true), a0, a1, b0, b1);
          if (axis === i) {
            const middle = before(columns, a0, a1, cut);
            go(node + 1, a0, middle, b0, b1);
            a0 = middle;
          } else if (axis === j) {
            const middle = before(rows, b0, b1, cut);
            go(node + 1, a0, a1, b0, middle);
            b0 = middle;
          } else if (axis >= n) {
            const row = (axis - n) * n, p = planes[row + i], q = planes[row + j];
            const base = compared(node, origin);
            const [xa, xb] = [p * columns[a0], p * columns[a1 - 1]];
            const [ya, yb] = [q * rows[b0], q * rows[b1 - 1]];
            if (base + Math.max(xa, xb) + Math.max(ya, yb) < cut) {
              node += 1;
              continue;
            }
            if (base + Math.min(xa, xb) + Math.min(ya, yb) < cut) {
              const wide = a1 - a0 > b1 - b0, a = (a0 + a1) >> 1, b = (b0 + b1) >> 1;
              go(node, a0, wide ? a : a1, b0, wide ? b1 : b);
              if (wide) a0 = a;
              else b0 = b;
              continue;
            }
          } else if (origin[axis] < cut) {
            node += 1;
            continue;
          }
          node = second[node];
        }
      }
      go(0, 0, across, 0, rows.length);
      return grid;
    },
  };
}
