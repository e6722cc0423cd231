/** Pixels between the samples of a target, and between the lines of its hatching. */
const GRAIN = 4, HATCH = 3;

/**
 * Return where a target is in the plane: {edge, hatch, points}, two Path2D in pixels, and the
 * points of the edge as shares of the plane. `inside(across, up)` tells whether shares of the plane
 * are in it; `toPixels` takes a pair of shares.
 */
export function targetPaths(inside, toPixels, width, height) {
  const across = Math.ceil(width / GRAIN), up = Math.ceil(height / GRAIN);
  const at = (column, row) => (inside(column / across, row / up) ? 1 : 0);
  const hatch = new Path2D(), links = new Map(), places = new Map();

  /** The shares between two points of the grid where the target ends. */
  function crossing(from, to, first) {
    let [low, high] = [from, to];
    for (let k = 0; k < 6; k++) {
      const middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
      if (at(...middle) === first) low = middle;
      else high = middle;
    }
    return [low[0] / across, low[1] / up];
  }

  /** The name of a side of a cell of the grid, the same from both cells. */
  const sideOf = ([a, b], [c, d]) => `${Math.min(a, c)},${Math.min(b, d)},${a === c ? 1 : 0}`;

  let below = null;
  for (let row = 0; row <= up; row++) {
    const here = Uint8Array.from({ length: across + 1 }, (_, column) => at(column, row));
    for (let column = 0; below && column < across; column++) {
      const corners = [below[column], below[column + 1], here[column + 1], here[column]];
      const sum = corners[0] + corners[1] + corners[2] + corners[3];
      if (sum === 0) continue;
      const [left, right, bottom, top] = [column, column + 1, row - 1, row];
      if (sum === 4) {
        if ((column + row) % HATCH) continue;
        hatch.moveTo(...toPixels([left / across, top / up]));
        hatch.lineTo(...toPixels([right / across, bottom / up]));
        continue;
      }
      const points = [[left, bottom], [right, bottom], [right, top], [left, top]];
      const crossed = [0, 1, 2, 3].filter(k => corners[k] !== corners[(k + 1) % 4]).map(k => {
        const [from, to] = [points[k], points[(k + 1) % 4]], side = sideOf(from, to);
        if (!places.has(side)) places.set(side, crossing(from, to, corners[k]));
        return side;
      });
      for (let k = 0; k + 1 < crossed.length; k += 2) {
        for (const [one, other] of [[crossed[k], crossed[k + 1]], [crossed[k + 1], crossed[k]]]) {
          if (!links.has(one)) links.set(one, []);
          links.get(one).push(other);
        }
      }
    }
    below = here;
  }
  return { hatch, edge: chained(links, side => toPixels(places.get(side))), points: [...places.values()] };
}

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
