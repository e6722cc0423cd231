import { readable } from "../dom/colors.js";
import { shape } from "../dom/elements.js";
import { beside, curve, loop, SIZE } from "./places.js";

/** Return an empty picture of an automaton, with its arrow tips. */
export function emptyShape(kind) {
  const tip = (id, name) => shape("marker", {
    id, class: name, viewBox: "0 0 8 8", refX: 7, refY: 4, markerWidth: 6.5, markerHeight: 6.5,
    orient: "auto-start-reverse", markerUnits: "userSpaceOnUse",
  }, shape("path", { d: "M0 0.6 L8 4 L0 7.4 Z" }));
  return shape("svg", { viewBox: `0 0 ${SIZE.width} ${SIZE.height}`, class: kind, role: "group",
    "aria-label": "Finite state machine of the policy" },
  shape("defs", {}, tip("tip", "tip"), tip("tip-taken", "tip taken"), tip("tip-off", "tip off")));
}

/**
 * Return the circle of a vertex: {label, node, stays}, where `stays` is the text that tells stays
 * beside it, {span, before}, else null.
 */
export function vertexShape({ layout, words, theme, symbolOf }, label, [x, y]) {
  const { kind, inside, radius } = layout, symbol = symbolOf(label), color = theme.color(symbol);
  const marked = theme.marks.dots(symbol) !== null;
  const text = words.short(label), size = Math.min(13, (radius * 1.75) / (0.6 * text.length));
  const node = shape("g", { class: "vertex", "data-symbol": symbol, tabindex: 0, role: "img" },
    shape("circle", { cx: x, cy: y, r: radius + 4, class: "ring" }),
    shape("circle", { cx: x, cy: y, r: radius, fill: marked ? `url(#marks-${symbol})` : color }));
  if (marked) node.prepend(theme.marks.node(symbol, 0.5));
  let stays = null;
  if (inside) {
    node.append(shape("text", { x, y: y + size * 0.35, "text-anchor": "middle", "font-size": size,
      class: "name", fill: readable(color) }, text));
  } else if (kind === "pair") put(node, [x, y + radius + 18], [text], "middle");
  else if (kind === "ring") {
    const upright = Math.abs(x - SIZE.width / 2) < 4, cells = words.cells(label);
    const at = beside([x, y], radius, upright ? 2 : 3);
    const spans = put(node, [at.x, at.y], upright ? [text, cells] : [text, cells, ""], at.anchor);
    stays = { span: spans.at(-1), before: upright ? `${cells} · ` : "" };
  }
  if (kind === "crowd" && layout.letters) {
    const at = beside([x, y], radius, 1), name = words.name(label);
    const cut = name.length > layout.letters ? `${name.slice(0, layout.letters - 1)}…` : name;
    put(node, [at.x, at.y], [cut], at.anchor);
  }
  return { label, node, stays };
}

function put(node, [x, y], lines, anchor) {
  const spans = lines.map((line, row) =>
    shape("tspan", { x, dy: row ? 11 : 0, class: row ? "" : "name" }, line));
  node.append(shape("text", { x, y, class: "count", "text-anchor": anchor }, spans));
  return spans;
}

/**
 * Return the arrow of an edge: the edge and {node, title, path, text, lines}; where its vertex
 * tells the stays there is `beside` instead of a path.
 */
export function edgeShape(edge, { kind, radius }, [from, to], stays) {
  const { source, target } = edge, stay = source === target, title = shape("title");
  const node = shape("g", { class: "edge", "data-edge": `${source}-${target}` }, title);
  if (stay && (kind === "ring" || kind === "crowd")) {
    return { ...edge, node, title, path: null, text: null, beside: stays };
  }
  const { d, at, anchor } = stay ? loop(from, radius, kind) : curve(from, to, radius, kind);
  const path = shape("path", { d, class: "wire" });
  const lines = [0, 1].map(k => shape("tspan", { x: at[0], dy: k ? 12 : 0 }));
  const text = shape("text", { x: at[0], y: at[1], class: "count", "text-anchor": anchor,
    "data-label": `${source}-${target}` }, lines);
  node.append(path);
  return { ...edge, node, title, path, text, lines };
}
