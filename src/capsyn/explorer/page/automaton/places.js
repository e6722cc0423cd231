/** The picture of an automaton: its size, and the most letters of a name. */
export const SIZE = { width: 340, height: 212 };
export const LETTERS = 14;
const CENTER = [SIZE.width / 2, SIZE.height / 2];
/** Letters of names that fit into the circles, and widths of letters and of counts in pixels. */
const FITTING = 9, LETTER = 6.1, COUNTS = 66;
/** Symbols from which circles have names alone, and of more than how many not even these. */
const CROWD = 17, MOST_NAMED = 36;
/** Letters of these names. */
const CROWDED = 6;

/**
 * Return where the vertices of an automaton are: {kind, inside, radius, places, letters}, with so
 * many letters of the names beside a crowd. One or two are
 * side by side ("pair"), three or four with short names in the corners ("corners"), else they are
 * on a ring with their texts around it ("ring"), or with short names at most ("crowd").
 */
export function placed(names) {
  const count = names.length, longest = Math.max(...names.map(name => name.length));
  const inside = longest <= FITTING && count <= 4;
  if (count <= 2) {
    const places = count === 1 ? [CENTER] : [-80, 80].map(x => [CENTER[0] + x, CENTER[1]]);
    return { kind: "pair", inside, radius: 32, places };
  }
  if (inside) {
    const corners = count === 3 ? [[0, -58], [64, 54], [-64, 54]]
      : [[-64, -58], [64, -58], [64, 58], [-64, 58]];
    const places = corners.map(([x, y]) => [CENTER[0] + x, CENTER[1] + y]);
    return { kind: "corners", inside, radius: 24, places };
  }
  const crowd = count >= CROWD;
  const radius = crowd ? Math.max(3, 130 / count) : Math.min(12, 100 / count);
  const named = crowd && count <= MOST_NAMED ? Math.min(longest, CROWDED) * LETTER : 0;
  const beside = crowd ? 8 + named : Math.max(COUNTS, Math.min(longest, LETTERS) * LETTER) + 8;
  const [across, up] = [CENTER[0] - radius - beside, CENTER[1] - radius - (crowd ? 8 + (named && 8) : 30)];
  const places = names.map((_, k) => {
    const angle = -Math.PI / 2 + (2 * Math.PI * k) / count;
    return [CENTER[0] + across * Math.cos(angle), CENTER[1] + up * Math.sin(angle)];
  });
  const letters = named ? CROWDED : 0;
  return { kind: crowd ? "crowd" : "ring", inside: false, radius, places, letters };
}

/** Return the texts' place beside a vertex on a ring: {x, y, anchor} of the first of `lines`. */
export function beside([x, y], radius, lines) {
  const [dx, dy] = [x - CENTER[0], y - CENTER[1]];
  if (Math.abs(dx) < 4) {
    return { x, y: dy < 0 ? y - radius - 6 - 11 * (lines - 1) : y + radius + 14, anchor: "middle" };
  }
  const side = Math.sign(dx), anchor = side > 0 ? "start" : "end";
  return { x: x + side * (radius + 6), y: y + 4 - (11 * (lines - 1)) / 2, anchor };
}

/** Return the arrow from a vertex to itself: {d, at, anchor}. */
export function loop([x, y], radius, kind) {
  const out = kind === "pair" ? -Math.PI / 2 : x < CENTER[0] ? Math.PI : 0;
  const reach = radius + (kind === "pair" ? 34 : 24), spread = 0.5;
  const point = (angle, far) => [x + far * Math.cos(angle), y + far * Math.sin(angle)];
  const [p, q] = [point(out - spread, radius + 1), point(out + spread, radius + 2)];
  const [u, v] = [point(out - spread * 1.25, reach), point(out + spread * 1.25, reach)];
  const d = `M${p} C${u} ${v} ${q}`, [tx, ty] = point(out, reach);
  if (kind === "pair") return { d, at: [tx, ty - 14], anchor: "middle" };
  return { d, at: [tx, ty - 2], anchor: out ? "end" : "start" };
}

/** Return the arrow between two vertices, clear of the others: {d, at, anchor}. */
export function curve([ax, ay], [bx, by], radius, kind) {
  const [dx, dy] = [bx - ax, by - ay], length = Math.hypot(dx, dy);
  const bow = { pair: 44, corners: 16 }[kind] ?? Math.min(12, 0.12 * length);
  const inward = kind === "ring" || kind === "crowd" ? 0.3 : 0;
  const [mx, my] = [(ax + bx) / 2, (ay + by) / 2];
  const mid = [
    mx + (CENTER[0] - mx) * inward + (dy / length) * bow,
    my + (CENTER[1] - my) * inward - (dx / length) * bow,
  ];
  const toward = (x, y, far) => {
    const size = Math.hypot(mid[0] - x, mid[1] - y);
    return [x + ((mid[0] - x) / size) * far, y + ((mid[1] - y) / size) * far];
  };
  const [p, q] = [toward(ax, ay, radius + 1), toward(bx, by, radius + 2)];
  const d = `M${p} Q${mid} ${q}`;
  if (kind === "pair") {
    const apex = (p[1] + 2 * mid[1] + q[1]) / 4;
    return { d, at: [mid[0], apex + (dx > 0 ? -19 : 15)], anchor: "middle" };
  }
  const share = [0.09, 0.42, 0.49]; // the curve at 0.7
  const [x, y] = [0, 1].map(k => share[0] * p[k] + share[1] * mid[k] + share[2] * q[k]);
  return { d, at: [x, y + 3], anchor: "middle" };
}
