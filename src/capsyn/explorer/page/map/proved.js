import { writeOver } from "../dom/canvas.js";
import { unpackRuns } from "../policy/packed.js";
import { toPixels } from "./frame.js";

/** What is known of a cell; `STAYS` is added where the loop stays, see `cell_map` in Python. */
const PROVED = 1, OPEN = 2, REFUTED = 3, STAYS = 4;

/** Red, green, blue and opacity of what lies over a cell; nothing lies over proved ones. */
const COVERS = {
  [PROVED]: [0, 0, 0, 0], [OPEN]: [123, 132, 144, 225], [REFUTED]: [192, 57, 43, 225],
};
const NO_START = { light: [255, 255, 255, 165], dark: [23, 27, 33, 175] };
const CROSS = 6;

/**
 * Return what is proved of each cell of a policy's map: {counts, strides, known}, with what is
 * `kept` of the slice that was drawn last; null for none.
 */
export function provedCells({ proved }) {
  if (!proved) return null;
  const { counts, runs } = proved;
  const strides = counts.map((_, i) => counts.slice(i + 1).reduce((a, b) => a * b, 1));
  return { counts, strides, known: unpackRuns(runs, strides[0] * counts[0]), kept: {} };
}

/**
 * Draw what is proved over the plane of a view: covers on cells that are not, the edge of the set
 * in which the loop stays, its ripple, and refuted starts. On a plane with an exogenous input it
 * draws nothing.
 */
export function drawProved(context, cells, frame, { data, theme, view }) {
  if (view.axes.some(axis => axis >= view.states)) return;
  const { across, up, image, sides } = slice(cells, theme, view);
  const corner = state => toPixels(frame, view.unturned(state));
  const [x0, y0] = corner(view.lower), [x1, y1] = corner(view.upper), flat = view.n === 1;
  const box = flat ? [x0, frame.y, x1 - x0, frame.height] : [x0, y1, x1 - x0, y0 - y1];
  const edge = path(sides, [box[0], box[1] + box[3]], [box[2] / across, box[3] / up]);
  context.save();
  context.beginPath();
  context.rect(frame.x, frame.y, frame.width, frame.height);
  context.clip();
  context.imageSmoothingEnabled = false;
  for (const [right, above] of turns(view)) {
    context.save();
    context.translate(right * box[2], -above * box[3]);
    context.drawImage(image, ...box);
    line(context, edge, theme, 1.8);
    if (data.proved.ripple) {
      const ripple = [0, 1].map(end => corner(data.proved.ripple.map(pair => pair[end])));
      drawRipple(context, ripple, flat ? [frame.y + frame.height, frame.y] : null, theme);
    }
    drawRefuted(context, cells, frame, corner, { data, theme, view });
    context.restore();
  }
  context.restore();
}

/** The cells of the plane of a view: how many, the image that covers them, and `sides`. */
function slice({ counts, strides, known, kept }, theme, view) {
  const [i, j] = view.axes, flat = view.n === 1, across = counts[i], up = flat ? 1 : counts[j];
  let first = 0;
  counts.forEach((count, axis) => {
    if (!view.axes.includes(axis)) first += strides[axis] * step(view, counts, axis, view.fixed);
  });
  const key = [i, j, first, theme.mode].join();
  if (kept.key !== key) {
    const at = (column, row) => known[first + column * strides[i] + (flat ? 0 : row * strides[j])];
    const cells = { across, up, at };
    Object.assign(kept, { key, across, up, image: cover(cells, theme), sides: edges(cells, view) });
  }
  return kept;
}

/** The cell along an axis in which a state is. */
function step(view, counts, axis, state) {
  const share = (state[axis] - view.lower[axis]) / view.width(axis);
  return Math.min(Math.max(Math.floor(share * counts[axis]), 0), counts[axis] - 1);
}

/** How often the plane is shifted by its periods, across and up. */
function turns({ axes, periodic, n }) {
  const [x, y] = axes.map((axis, side) =>
    (periodic[axis] && !(side && n === 1) ? [-1, 0, 1] : [0]));
  return x.flatMap(across => y.map(up => [across, up]));
}

/** Return a canvas with a pixel for each cell, which covers what is not proved. */
function cover({ across, up, at }, { mode }) {
  const canvas = new OffscreenCanvas(across, up), context = canvas.getContext("2d");
  const image = context.createImageData(across, up);
  for (let row = 0, k = 0; row < up; row++) {
    for (let column = 0; column < across; column++, k += 4) {
      image.data.set(COVERS[at(column, up - 1 - row) & 3] ?? NO_START[mode], k);
    }
  }
  context.putImageData(image, 0, 0);
  return canvas;
}

/** Return the sides around the cells in which the loop stays: [column, row, upright] of each. */
function edges({ across, up, at }, { axes, periodic, n }) {
  const found = [], round = axes.map((axis, side) => periodic[axis] && !(side && n === 1));
  const stays = (column, row) => {
    if (!round[0] && (column < 0 || column >= across)) return 0;
    if (!round[1] && (row < 0 || row >= up)) return 0;
    return at((column + across) % across, (row + up) % up) & STAYS;
  };
  for (let row = 0; row <= up; row++) {
    for (let column = 0; column <= across; column++) {
      const here = stays(column, row);
      if (row < up && here !== stays(column - 1, row)) found.push([column, row, true]);
      if (column < across && here !== stays(column, row - 1)) found.push([column, row, false]);
    }
  }
  return found;
}

/** Return the path along sides of cells of some size [pixels] from a lower left corner. */
function path(sides, [x, y], [wide, high]) {
  const found = new Path2D();
  for (const [column, row, upright] of sides) {
    const [left, lower] = [x + column * wide, y - row * high];
    found.moveTo(left, lower);
    found.lineTo(left + (upright ? 0 : wide), lower - (upright ? high : 0));
  }
  return found;
}

function line(context, path, { halo, ink }, width) {
  context.lineCap = "butt";
  for (const [color, more] of [[halo, 2], [ink, 0]]) {
    context.strokeStyle = color;
    context.lineWidth = width + more;
    context.stroke(path);
  }
}

/** The bounds of the states once the loop stays, from corner to corner; `heights` of a strip. */
function drawRipple(context, [[x0, y0], [x1, y1]], heights, theme) {
  const [low, high] = heights ?? [y0, y1], box = new Path2D();
  box.rect(x0, high, x1 - x0, low - high);
  context.setLineDash([4, 3]);
  line(context, box, theme, 1.4);
  context.setLineDash([]);
}

/** Crosses at the refuted starts of the slice, the first of each failure with its name. */
function drawRefuted(context, { counts }, frame, corner, { data, theme, view }) {
  const told = new Set();
  for (const { state, failure } of data.proved.refuted) {
    const beside = counts.some((_, axis) => !view.axes.includes(axis) &&
      step(view, counts, axis, state) !== step(view, counts, axis, view.fixed));
    if (beside) continue;
    const [x, y] = corner(state), d = CROSS;
    line(context, new Path2D(`M${x - d} ${y - d}l${2 * d} ${2 * d}m0 ${-2 * d}l${-2 * d} ${2 * d}`),
      theme, 1.8);
    if (told.has(failure)) continue;
    const ahead = x < frame.x + frame.width / 2;
    writeOver(context, failure, [x + (ahead ? 10 : -10), y - 8], theme, "600 12",
      ahead ? "left" : "right");
    told.add(failure);
  }
}
