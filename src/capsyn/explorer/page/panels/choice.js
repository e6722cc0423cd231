import { element, shape } from "../dom/elements.js";
import { ticks, tickText } from "../dom/text.js";

const WIDTH = 460, HEIGHT = 210, LEFT = 56, RIGHT = 12, TOP = 10, BOTTOM = 34;

/** Symbols that kinds of the same number stand apart, and the marks of kinds. */
const KINDS = { chosen: -0.12, own: -0.04, uniform: 0.04, random: 0.12 };
const MARKS = {
  chosen: "M-4 0 A4 4 0 1 1 4 0 A4 4 0 1 1 -4 0 Z", own: "M0 -5 L5 0 L0 5 L-5 0 Z",
  uniform: "M-4 -4 H4 V4 H-4 Z", random: "M0 -5 L5 4 H-5 Z",
};

/**
 * Return a picture of alphabets, {kind, symbols, objective, low, high} each: the objective with its
 * interval over the number of symbols; none where there are none.
 */
export function choicePicture(points) {
  if (!points.length) return null;
  const counts = points.map(({ symbols }) => symbols), values = points.flatMap(p => [p.low, p.high]);
  const across = scale(Math.min(...counts) - 0.5, Math.max(...counts) + 0.5, LEFT, WIDTH - RIGHT);
  const spare = 0.06 * (Math.max(...values) - Math.min(...values)) || 1;
  const up = scale(Math.min(...values) - spare, Math.max(...values) + spare, HEIGHT - BOTTOM, TOP);
  const place = ({ kind, symbols }) => across(symbols + KINDS[kind]);
  const chosen = points.filter(({ kind }) => kind === "chosen").sort((a, b) => a.symbols - b.symbols);
  const line = chosen.map((p, k) => `${k ? "L" : "M"}${place(p)} ${up(p.objective)}`).join("");
  const svg = shape("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "choice", role: "img",
    "aria-label": "Objective of alphabets over the number of their symbols" },
  ...axes(across, up),
  shape("path", { d: line, class: "chosen line" }),
  points.map(point => mark(point, place(point), up)));
  const kinds = Object.keys(KINDS).filter(kind => points.some(point => point.kind === kind));
  return element("figure", { class: "choice" }, svg, element("figcaption", { class: "note" },
    kinds.map(kind => element("span", {}, legend(kind), kind)), "mean objective; bars: its 95 % interval"));
}

/** Return the function from [low, high] to [from, to], with its bounds. */
function scale(low, high, from, to) {
  const place = value => Number((from + ((value - low) / (high - low)) * (to - from)).toFixed(1));
  return Object.assign(place, { low, high });
}

function axes(across, up) {
  const bottom = HEIGHT - BOTTOM, rows = ticks(up.low, up.high, 4);
  const columns = ticks(across.low, across.high, 8).filter(Number.isInteger);
  const text = (x, y, anchor, words) => shape("text", { x, y, "text-anchor": anchor }, words);
  return [
    rows.map(value => shape("path", { d: `M${LEFT} ${up(value)}H${WIDTH - RIGHT}`, class: "grid" })),
    rows.map((value, k) => text(LEFT - 6, up(value) + 4, "end", tickText(rows)(value, k))),
    columns.map(value => text(across(value), bottom + 15, "middle", String(value))),
    text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 4, "middle", "symbols"),
  ];
}

function mark({ kind, symbols, objective, low, high }, x, up) {
  return shape("g", { class: kind },
    shape("title", {}, `${kind}, ${symbols} symbols: ${objective}`),
    shape("path", { d: `M${x} ${up(low)}V${up(high)}`, class: "line" }),
    shape("path", { d: MARKS[kind], transform: `translate(${x} ${up(objective)})` }));
}

function legend(kind) {
  return shape("svg", { viewBox: "-6 -6 12 12", class: kind, width: 12, height: 12 },
    shape("path", { d: MARKS[kind] }));
}
