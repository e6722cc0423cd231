import { draw, makeTaken, makeWords, sweep } from "../../automaton/automaton.js";
import { placed } from "../../automaton/places.js";
import { byId, element } from "../../dom/elements.js";
import { counted } from "../../dom/text.js";

/**
 * Return the graph of the finite state machine, see the other `makeAutomaton`. There an edge has the
 * cells of its target; here it has its own: those in which its target follows its source. Those of
 * a vertex are where it stays.
 */
export function makeAutomaton(app) {
  const { data } = app, last = data.controls.length - 1, { vertices, what } = data.automaton;
  const plain = makeWords(data);
  const size = ({ cells }) => counted(cells, what === "leaves" ? "leaf" : "cell", what);
  /** The words of an edge, with its own cells. */
  const edge = one => plain.edge(one).replace(`: ${plain.cells(one.target)}`, () => `: ${size(one)}`);
  const graph = {
    app, words: { ...plain, edge }, root: byId("automaton"),
    caption: element("p", { class: "caption", "aria-live": "polite" }),
    layout: placed(vertices.map(({ symbol }) => plain.name(symbol))),
    taken: makeTaken(last), symbolOf: label => (label === last ? -1 : label),
    circles: [], arrows: [], shown: null,
  };

  /** Write the cells of edges beside them, where there is room. */
  function told(show) {
    show(graph);
    for (const arrow of graph.arrows) {
      const own = arrow.lines && (graph.layout.kind === "pair" || arrow.source === arrow.target);
      if (own) arrow.lines[0].textContent = size(arrow);
    }
  }

  return { draw: () => told(draw), sweep: () => told(sweep), taken: graph.taken.all };
}
