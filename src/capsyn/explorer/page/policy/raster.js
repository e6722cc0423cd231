import { INSIDE, NONE } from "./symbols.js";

/** The steps of `size` points along an axis: which there are, ascending; each point's, or -1. */
function along(domain, axis, size, position) {
  const steps = new Int32Array(size);
  for (let p = 0; p < size; p++) {
    const x = position(p);
    steps[p] = domain.holds(axis, x) ? domain.step(axis, x) : -1;
  }
  const distinct = [...new Set(steps)].filter(k => k >= 0).sort((a, b) => a - b);
  const order = new Map(distinct.map((k, index) => [k, index]));
  return { distinct, index: steps.map(k => (k < 0 ? -1 : order.get(k))) };
}

/**
 * Return what cells are at the centres of pixels of a plane, see `makeLookup`:
 * `value(place, whole)` of each pixel's cell, NONE outside the domain, in an array of `Pixels`.
 */
export function raster(domain, cells, plane, Pixels, value) {
  const { axes: [i, j], fixed, bounds: [x0, x1, y0, y1], width, height, level } = plane;
  const across = along(domain, i, width, p => x0 + ((p + 0.5) / width) * (x1 - x0));
  const down = along(domain, j, height, p => y1 - ((p + 0.5) / height) * (y1 - y0));
  const columns = across.distinct, rows = down.distinct;
  const pixels = new Pixels(width * height).fill(NONE);
  const z = Array.from(fixed);
  z[i] = domain.lower[i];
  z[j] = domain.lower[j];
  if (domain.status(z) !== INSIDE || !columns.length || !rows.length) return pixels;
  const section = { z: domain.steps(z), i, j, columns, rows, depth: level ?? Infinity, value };
  spread(pixels, cells.section(section), across, down);
  return pixels;
}

/** Fill pixels from a grid that has each of their steps once. */
function spread(pixels, grid, across, down) {
  const width = across.index.length, columns = across.distinct.length;
  down.index.forEach((row, r) => {
    const start = r * width;
    if (row < 0) return;
    if (r && down.index[r - 1] === row) {
      pixels.copyWithin(start, start - width, start);
      return;
    }
    for (let c = 0; c < width; c++) {
      const column = across.index[c];
      if (column >= 0) pixels[start + c] = grid[row * columns + column];
    }
  });
}

/** Fill the part [a0, a1) x [b0, b1) of a grid. */
export function fill(grid, across, value, a0, a1, b0, b1) {
  for (let b = b0; b < b1; b++) grid.fill(value, b * across + a0, b * across + a1);
}
