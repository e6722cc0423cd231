import { byId, shape, whole } from "./dom.js";
import { readable } from "./theme.js";

const SIZE = { width: 310, height: 215 };
/** Up to so many symbols every edge is labelled; else those that were taken. */
const FEW = 3;

/**
 * Return the graph of the finite state machine: {draw, sweep}. An edge shows the cells of the
 * region that is its guard, and how often the active trajectory has taken it so far.
 */
export function makeAutomaton(app) {
  const { data } = app, { vertices, edges, what } = data.automaton, root = byId("automaton");
  const count = vertices.length, last = data.controls.length - 1;
  const symbolOf = label => (label === last ? -1 : label);
  const radius = count <= 2 ? 34 : count <= 4 ? 27 : Math.max(9, 104 / count + 9);
  const center = [SIZE.width / 2, SIZE.height / 2];
  const ring = count <= 2 ? [78, 0] : [SIZE.width / 2 - radius - 38, SIZE.height / 2 - radius - 15];
  const places = vertices.map((_, k) => {
    const angle = count <= 2 ? Math.PI * (1 - k) : -Math.PI / 2 + (2 * Math.PI * k) / count;
    return count === 1 ? center
      : [center[0] + ring[0] * Math.cos(angle), center[1] + ring[1] * Math.sin(angle)];
  });
  const index = new Map(vertices.map((vertex, k) => [vertex.symbol, k]));
  const cellsOf = label => `${whole(vertices[index.get(label)].cells)} ${what}`;
  let circles = [], arrows = [], seen = { track: null, k: 0, taken: new Map() };

  function draw() {
    const arrow = (id, cls) => shape("marker", { id, class: cls, viewBox: "0 0 8 8", refX: 7, refY: 4,
      markerWidth: 6.5, markerHeight: 6.5, orient: "auto-start-reverse", markerUnits: "userSpaceOnUse" },
    shape("path", { d: "M0 0.6 L8 4 L0 7.4 Z" }));
    const svg = shape("svg", { viewBox: `0 0 ${SIZE.width} ${SIZE.height}`, role: "img",
      class: count > 4 ? "crowded" : "",
      "aria-label": "Finite state machine of the policy" },
    shape("defs", {}, arrow("tip", "tip"), arrow("tip-taken", "tip taken"), arrow("tip-off", "tip off")));
    arrows = edges.filter(edge => count <= 10 || edge.possible !== false || edge.source === edge.target)
      .map(edge => {
        const { d, at, anchor } = curve(index.get(edge.source), index.get(edge.target));
        const title = `${name(edge.source)} → ${name(edge.target)}: ${cellsOf(edge.target)}` +
          (edge.possible === false ? ", proved impossible"
            : edge.possible === null && data.loops ? ", not decided" : "") +
          (edge.sliding ? ", chatters somewhere" : "");
        const path = shape("path", { d, class: "wire" });
        const lines = [0, 1].map(k => shape("tspan", { x: at[0], dy: k ? 12 : 0 }));
        const text = shape("text", { x: at[0], y: at[1], class: "count", "text-anchor": anchor,
          "data-label": `${edge.source}-${edge.target}` }, lines);
        const node = shape("g", { class: "edge", "data-edge": `${edge.source}-${edge.target}` },
          shape("title", {}, title), path);
        svg.append(node);
        return { ...edge, key: `${edge.source}>${edge.target}`, node, path, text, lines };
      });
    circles = vertices.map(({ symbol }, k) => {
      const [x, y] = places[k], color = app.theme.color(symbolOf(symbol));
      const text = name(symbol), room = radius * 1.7;
      const size = Math.max(7, Math.min(13, room / (0.56 * text.length)));
      const node = shape("g", { class: "vertex", "data-symbol": symbolOf(symbol) },
        shape("title", {}, `${text}: ${cellsOf(symbol)}`),
        shape("circle", { cx: x, cy: y, r: radius + 4, class: "ring" }),
        shape("circle", { cx: x, cy: y, r: radius, fill: color }),
        shape("text", { x, y: y + size * 0.35, "text-anchor": "middle", "font-size": size,
          fill: readable(color) }, text.length > 14 ? `${text.slice(0, 13)}…` : text));
      svg.append(node);
      return { symbol, node };
    });
    svg.append(...arrows.map(edge => edge.text)); // over the wires and the circles
    root.replaceChildren(svg);
    seen = { track: null, k: 0, taken: new Map() };
    sweep();
  }

  const name = label => data.symbols[label];

  function curve(a, b) {
    const [ax, ay] = places[a], [bx, by] = places[b];
    if (a === b) {
      const out = count === 1 ? -Math.PI / 2
        : count === 2 ? -Math.PI / 2
          : Math.atan2(ay - center[1], ax - center[0]);
      const point = (angle, far) => [ax + far * Math.cos(angle), ay + far * Math.sin(angle)];
      const spread = 0.5, reach = radius + Math.min(34, radius * 1.25);
      const [p, q] = [point(out - spread, radius + 1), point(out + spread, radius + 2)];
      const [u, v] = [point(out - spread * 1.25, reach), point(out + spread * 1.25, reach)];
      const at = point(out, reach + 4);
      const side = Math.cos(out);
      return {
        d: `M${p} C${u} ${v} ${q}`,
        at: count <= 2 ? [at[0], at[1] - 9] : [at[0] + side * 4, at[1] + Math.sin(out) * 6 + 3],
        anchor: count <= 2 || Math.abs(side) < 0.3 ? "middle" : side > 0 ? "start" : "end",
      };
    }
    const [dx, dy] = [bx - ax, by - ay], length = Math.hypot(dx, dy);
    const [nx, ny] = [dy / length, -dx / length], bow = count <= 2 ? 44 : Math.min(26, 0.16 * length);
    const mid = [(ax + bx) / 2 + nx * bow, (ay + by) / 2 + ny * bow];
    const toward = (x, y, far) => {
      const size = Math.hypot(mid[0] - x, mid[1] - y);
      return [x + ((mid[0] - x) / size) * far, y + ((mid[1] - y) / size) * far];
    };
    const [p, q] = [toward(ax, ay, radius + 1), toward(bx, by, radius + 2)];
    const d = `M${p} Q${mid} ${q}`;
    if (count <= 2) {
      const apex = [mid[0], (p[1] + 2 * mid[1] + q[1]) / 4];
      return { d, at: [apex[0], apex[1] + (ny > 0 ? 15 : -19)], anchor: "middle" };
    }
    const near = [p, mid, q].reduce((sum, [x, y], k) => {
      const share = [0.09, 0.42, 0.49][k]; // the curve at 0.7
      return [sum[0] + share * x, sum[1] + share * y];
    }, [0, 0]);
    return { d, at: [near[0], near[1] + 3], anchor: "middle" };
  }

  /** Count the transitions up to the present; going back counts anew. */
  function countTaken(track, now) {
    const stop = Math.min(now, track.symbols.length - 1);
    if (seen.track !== track || stop < seen.k) seen = { track, k: 0, taken: new Map() };
    for (let k = seen.k + 1; k <= stop; k++) {
      const key = [track.symbols[k - 1], track.symbols[k]].map(s => (s < 0 ? last : s)).join(">");
      seen.taken.set(key, (seen.taken.get(key) ?? 0) + 1);
    }
    seen.k = Math.max(stop, 0);
  }

  function sweep() {
    const track = app.active, now = track ? app.progress(track) : 0;
    if (track && track.symbols.length) countTaken(track, now);
    else seen = { track: null, k: 0, taken: new Map() };
    const active = track && track.symbols.length
      ? track.symbols[Math.min(now, track.symbols.length - 1)] : null;
    for (const { symbol, node } of circles) {
      node.classList.toggle("lit", active !== null && symbolOf(symbol) === active);
    }
    for (const edge of arrows) {
      const taken = seen.taken.get(edge.key) ?? 0, off = edge.possible === false && !taken;
      edge.node.classList.toggle("taken", taken > 0);
      edge.node.classList.toggle("off", off);
      edge.text.classList.toggle("taken", taken > 0);
      edge.node.dataset.taken = taken;
      edge.path.setAttribute("marker-end", `url(#tip${taken ? "-taken" : off ? "-off" : ""})`);
      const few = count <= FEW;
      edge.lines[0].textContent = few ? cellsOf(edge.target) : taken ? `${whole(taken)}×` : "";
      edge.lines[1].textContent = few ? `${whole(taken)}×` : "";
    }
  }

  /** Return how often each edge has been taken, by "source>target". */
  const taken = () => Object.fromEntries(seen.taken);
  return { draw, sweep, taken };
}
