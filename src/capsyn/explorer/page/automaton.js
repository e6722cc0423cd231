import { beside, curve, LETTERS, loop, placed, SIZE } from "./automaton_places.js";
import { byId, counted, element, shape, whole } from "./dom.js";
import { readable } from "./theme.js";

/** Up to so many symbols, arrows that are proved impossible are drawn. */
const MOST_OFF = 10;

/**
 * Return the graph of the finite state machine: {draw, sweep, taken}. An edge shows the cells of the
 * region that is its guard, and how often the active trajectory has taken it so far; where there is
 * no room, cells and stays stand beside the symbol. A symbol that is pointed at, or has the focus,
 * shows its edges alone, and tells them in words.
 */
export function makeAutomaton(app) {
  const { data } = app, { vertices, edges, what } = data.automaton, root = byId("automaton");
  const last = data.controls.length - 1, name = label => data.symbols[label];
  const symbolOf = label => (label === last ? -1 : label);
  const index = new Map(vertices.map((vertex, k) => [vertex.symbol, k]));
  const { kind, inside, radius, places } = placed(vertices.map(({ symbol }) => name(symbol)));
  const cut = text => (text.length > LETTERS ? `${text.slice(0, LETTERS - 1)}…` : text);
  const cellsOf = label => counted(vertices[index.get(label)].cells, what === "leaves" ? "leaf" : "cell", what);
  const caption = element("p", { class: "caption", "aria-live": "polite" });
  let circles = [], arrows = [], told = null, seen = { track: null, k: 0, taken: new Map() };

  const words = ({ source, target, possible, sliding, count }) => [
    `${name(source)} → ${name(target)}: ${cellsOf(target)}`,
    data.loops && `taken ${whole(count ?? 0)}×`,
    possible === false && "proved impossible",
    possible === null && data.loops && "not decided",
    sliding && "chatters somewhere",
  ].filter(Boolean).join(", ");

  function draw() {
    const arrow = (id, cls) => shape("marker", { id, class: cls, viewBox: "0 0 8 8", refX: 7, refY: 4,
      markerWidth: 6.5, markerHeight: 6.5, orient: "auto-start-reverse", markerUnits: "userSpaceOnUse" },
    shape("path", { d: "M0 0.6 L8 4 L0 7.4 Z" }));
    const svg = shape("svg", { viewBox: `0 0 ${SIZE.width} ${SIZE.height}`, class: kind, role: "group",
      "aria-label": "Finite state machine of the policy" },
    shape("defs", {}, arrow("tip", "tip"), arrow("tip-taken", "tip taken"), arrow("tip-off", "tip off")));
    circles = vertices.map(vertex);
    arrows = edges.filter(edge =>
      vertices.length <= MOST_OFF || edge.possible !== false || edge.source === edge.target).map(wire);
    svg.append(...arrows.map(edge => edge.node), ...circles.map(circle => circle.node),
      ...arrows.map(edge => edge.text).filter(text => text && !text.parentNode));
    root.replaceChildren(svg, caption);
    seen = { track: null, k: 0, taken: new Map() };
    sweep();
  }

  function vertex({ symbol }, k) {
    const [x, y] = places[k], color = app.theme.color(symbolOf(symbol)), text = cut(name(symbol));
    const size = Math.min(13, (radius * 1.75) / (0.6 * text.length));
    const node = shape("g", { class: "vertex", "data-symbol": symbolOf(symbol), tabindex: 0, role: "img" },
      shape("circle", { cx: x, cy: y, r: radius + 4, class: "ring" }),
      shape("circle", { cx: x, cy: y, r: radius, fill: color }));
    const circle = { symbol, node, stays: null };
    const put = (at, lines, anchor) => {
      const spans = lines.map((line, row) => shape("tspan", { x: at[0], dy: row ? 11 : 0, class: row ? "" : "name" }, line));
      node.append(shape("text", { x: at[0], y: at[1], class: "count", "text-anchor": anchor }, spans));
      return spans;
    };
    if (inside) {
      node.append(shape("text", { x, y: y + size * 0.35, "text-anchor": "middle", "font-size": size,
        class: "name", fill: readable(color) }, text));
    } else if (kind === "pair") put([x, y + radius + 18], [text], "middle");
    else if (kind === "ring") {
      const upright = Math.abs(x - SIZE.width / 2) < 4, lines = upright ? 2 : 3;
      const at = beside([x, y], radius, lines), more = upright ? [cellsOf(symbol)] : [cellsOf(symbol), ""];
      const spans = put([at.x, at.y], [text, ...more], at.anchor);
      circle.stays = { span: spans.at(-1), before: upright ? `${cellsOf(symbol)} · ` : "" };
    }
    node.addEventListener("focus", () => tell(symbol));
    node.addEventListener("blur", () => tell(null));
    node.addEventListener("pointerenter", () => tell(symbol));
    node.addEventListener("pointerleave", () => tell(null));
    return circle;
  }

  function wire(edge) {
    const { source, target } = edge, [from, to] = [index.get(source), index.get(target)];
    const title = shape("title"), key = `${source}>${target}`, stays = source === target;
    const node = shape("g", { class: "edge", "data-edge": `${source}-${target}` }, title);
    if (stays && (kind === "ring" || kind === "crowd")) {
      return { ...edge, key, node, title, path: null, text: null, ...circles[from] && { beside: circles[from].stays } };
    }
    const { d, at, anchor } = stays ? loop(places[from], radius, kind)
      : curve(places[from], places[to], radius, kind);
    const path = shape("path", { d, class: "wire" });
    const lines = [0, 1].map(k => shape("tspan", { x: at[0], dy: k ? 12 : 0 }));
    const text = shape("text", { x: at[0], y: at[1], class: "count", "text-anchor": anchor,
      "data-label": `${source}-${target}` }, lines);
    node.append(path);
    return { ...edge, key, node, title, path, text, lines };
  }

  /** Show the edges of a symbol alone, and tell them; all for null. */
  function tell(symbol) {
    told = symbol;
    root.firstChild.classList.toggle("told", symbol !== null);
    for (const { source, target, node, text } of arrows) {
      for (const part of [node, text]) part?.classList.toggle("own", symbol === source || symbol === target);
    }
    describe();
  }

  function describe() {
    const own = arrows.filter(edge => edge.source === told);
    own.sort((a, b) => (b.count ?? 0) - (a.count ?? 0));
    const text = own.map(words).join("; ");
    if (caption.textContent !== text) caption.textContent = text;
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
      const count = seen.taken.get(edge.key) ?? 0;
      if (edge.count !== count) write(edge, count);
    }
    for (const { symbol, node } of circles) label(symbol, node);
    if (told !== null) describe();
  }

  function label(symbol, node) {
    if (document.activeElement !== node && node.hasAttribute("aria-label")) return;
    node.setAttribute("aria-label", arrows.filter(edge => edge.source === symbol).map(words).join("; "));
  }

  function write(edge, count) {
    const off = edge.possible === false && !count, times = data.loops ? `${whole(count)}×` : "";
    edge.count = count;
    edge.node.classList.toggle("taken", count > 0);
    edge.node.classList.toggle("off", off);
    edge.node.dataset.taken = count;
    edge.title.textContent = words(edge);
    if (edge.beside) edge.beside.span.textContent = `${edge.beside.before}${times && `↻ ${times}`}`;
    if (!edge.path) return;
    edge.text.classList.toggle("taken", count > 0);
    edge.path.setAttribute("marker-end", `url(#tip${count ? "-taken" : off ? "-off" : ""})`);
    const full = kind === "pair" || edge.source === edge.target;
    edge.lines[0].textContent = full ? cellsOf(edge.target) : count ? times : "";
    edge.lines[1].textContent = full ? times : "";
  }

  /** How often each edge has been taken, by "source>target". */
  const taken = () => Object.fromEntries(seen.taken);
  return { draw, sweep, taken };
}
