/** Pixels between the samples of a region, and between the lines of its hatching. */
const GRAIN = 4, HATCH = 3;

/**
 * Return where a region is in the plane of a view: {edge, hatch, points}, two Path2D in pixels, and
 * the points of the edge as shares of the plane. `holds` tells whether a reading is in it, `pixels`
 * takes a pair of shares.
 */
export function regionPaths(view, { width, height }, pixels, holds) {
  const [x0, x1, y0, y1] = view.bounds, [i, j] = view.axes;
  const state = Float64Array.from(view.fixed);
  const across = Math.ceil(width / GRAIN), up = Math.ceil(height / GRAIN);
  const shares = ([column, row]) => [column / across, row / up];
  const at = ([column, row]) => {
    state[i] = x0 + (column / across) * (x1 - x0);
    state[j] = y0 + (row / up) * (y1 - y0);
    return holds(state) ? 1 : 0;
  };
  const edge = new Edge(at), hatch = new Path2D();
  let below = null;
  for (let row = 0; row <= up; row++) {
    const here = Uint8Array.from({ length: across + 1 }, (_, column) => at([column, row]));
    for (let column = 0; below && column < across; column++) {
      const corners = [below[column], below[column + 1], here[column + 1], here[column]];
      const sum = corners[0] + corners[1] + corners[2] + corners[3];
      if (sum === 4 && (column + row) % HATCH === 0) {
        hatch.moveTo(...pixels(shares([column, row])));
        hatch.lineTo(...pixels(shares([column + 1, row - 1])));
      }
      if (sum !== 0 && sum !== 4) edge.cross(column, row, corners);
    }
    below = here;
  }
  const line = chained(edge.links, side => pixels(shares(edge.places.get(side))));
  return { hatch, edge: line, points: [...edge.places.values()].map(shares) };
}

/** The edge of what is inside on a grid: where it crosses sides of cells, and which are linked. */
class Edge {
  constructor(at) {
    Object.assign(this, { at, links: new Map(), places: new Map() });
  }

  /** Take the cell below and right of a point of the grid, some of whose corners are inside. */
  cross(column, row, corners) {
    const points = [[column, row - 1], [column + 1, row - 1], [column + 1, row], [column, row]];
    const crossed = [0, 1, 2, 3].filter(k => corners[k] !== corners[(k + 1) % 4]).map(k => {
      const [from, to] = [points[k], points[(k + 1) % 4]], side = sideOf(from, to);
      if (!this.places.has(side)) this.places.set(side, this.between(from, to, corners[k]));
      return side;
    });
    crossed.forEach((side, k) => {
      if (!this.links.has(side)) this.links.set(side, []);
      this.links.get(side).push(crossed[k ^ 1]);
    });
  }

  /** The place between two points of the grid where it is; `first` is what is at `from`. */
  between(from, to, first) {
    let [low, high] = [from, to];
    for (let k = 0; k < 6; k++) {
      const middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
      if (this.at(middle) === first) low = middle;
      else high = middle;
    }
    return low;
  }
}

/** The name of a side of a cell of the grid, the same from both cells. */
const sideOf = ([a, b], [c, d]) => `${Math.min(a, c)},${Math.min(b, d)},${a === c ? 1 : 0}`;

/** Lines through linked points, each as long as can be so that dashes go on along it. */
function chained(links, pixels) {
  const lines = new Path2D(), ends = [...links.keys()].filter(side => links.get(side).length === 1);
  for (const first of [...ends, ...links.keys()]) {
    for (let side = first, started = false; ;) {
      const next = links.get(side).pop();
      if (next === undefined) break;
      links.get(next).splice(links.get(next).indexOf(side), 1);
      if (!started) lines.moveTo(...pixels(side));
      lines.lineTo(...pixels(next));
      [side, started] = [next, true];
    }
  }
  return lines;
}
