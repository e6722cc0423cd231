import { counted, whole } from "../dom/text.js";
import { LETTERS } from "./places.js";

/**
 * Return how an automaton is told in words: {name, short, cells, edge}. Of a label its name, the
 * name cut to where there is room, and its cells; and an edge, with its `count` so far.
 */
export function makeWords({ automaton: { vertices, what }, symbols, loops }) {
  const sizes = new Map(vertices.map(({ symbol, cells }) => [symbol, cells]));
  const name = label => symbols[label];
  const cells = label => counted(sizes.get(label), what === "leaves" ? "leaf" : "cell", what);

  function short(label) {
    const text = name(label);
    return text.length > LETTERS ? `${text.slice(0, LETTERS - 1)}…` : text;
  }

  const edge = ({ source, target, possible, sliding, count }) => [
    `${name(source)} → ${name(target)}: ${cells(target)}`,
    loops && `taken ${whole(count ?? 0)}×`,
    possible === false && "proved impossible",
    possible === null && loops && "not decided",
    sliding && "chatters somewhere",
  ].filter(Boolean).join(", ");

  return { name, short, cells, edge };
}
