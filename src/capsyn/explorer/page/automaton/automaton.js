import { byId, element } from "../dom/elements.js";
import { counted, whole } from "../dom/text.js";
import { progress, symbolAt } from "../state/tracks.js";
import { LETTERS, placed } from "./places.js";
import { edgeShape, emptyShape, vertexShape } from "./shapes.js";

/** Up to so many symbols, arrows that are proved impossible are drawn. */
const MOST_OFF = 10;

/** More arrows than these are not drawn, but for stays. */
const MOST_ARROWS = 1500;

/**
 * Return the graph of the finite state machine: {draw, sweep, taken}. An edge shows the cells of
 * the region that is its guard, and how often the active trajectory has taken it so far; where
 * there is no room, cells and stays stand beside the symbol. A symbol that is pointed at, or has
 * the focus, shows its edges alone, and tells them in words. Labels are symbols, the default last.
 */
export function makeAutomaton(app) {
  const { data } = app, last = data.controls.length - 1, words = makeWords(data);
  const graph = {
    app, words, root: byId("automaton"),
    caption: element("p", { class: "caption", "aria-live": "polite" }),
    layout: placed(data.automaton.vertices.map(({ symbol }) => words.name(symbol))),
    taken: makeTaken(last), symbolOf: label => (label === last ? -1 : label),
    circles: [], arrows: [], shown: null,
  };
  return { draw: () => draw(graph), sweep: () => sweep(graph), taken: graph.taken.all };
}

export function draw(graph) {
  const { app, layout, words, symbolOf } = graph, { vertices, edges } = app.data.automaton;
  const index = new Map(vertices.map(({ symbol }, k) => [symbol, k]));
  graph.circles = vertices.map(({ symbol }, k) =>
    vertexShape({ layout, words, symbolOf, theme: app.theme }, symbol, layout.places[k]));
  const shown = edges.filter(({ possible, source, target }) =>
    vertices.length <= MOST_OFF || possible !== false || source === target);
  const few = shown.length <= MOST_ARROWS;
  graph.arrows = shown.filter(edge => few || edge.source === edge.target).map(edge => {
    const ends = [edge.source, edge.target].map(label => index.get(label));
    const { stays } = graph.circles[ends[0]];
    return edgeShape(edge, layout, ends.map(k => layout.places[k]), stays);
  });
  for (const circle of graph.circles) listen(graph, circle);
  const svg = emptyShape(layout.kind);
  svg.append(...graph.arrows.map(edge => edge.node), ...graph.circles.map(circle => circle.node),
    ...graph.arrows.map(edge => edge.text).filter(Boolean));
  graph.root.replaceChildren(svg, graph.caption);
  sweep(graph);
}

function listen(graph, { label, node }) {
  const shown = { focus: label, pointerenter: label, blur: null, pointerleave: null };
  for (const event of Object.keys(shown)) {
    node.addEventListener(event, () => show(graph, shown[event]));
  }
}

/** Show the edges of a label alone, and tell them; all for null. */
function show(graph, label) {
  graph.shown = label;
  graph.root.firstChild.classList.toggle("told", label !== null);
  for (const { source, target, node, text } of graph.arrows) {
    const own = label === source || label === target;
    for (const part of [node, text]) part?.classList.toggle("own", own);
  }
  describe(graph);
}

function describe({ arrows, shown, words, caption }) {
  const own = arrows.filter(edge => edge.source === shown);
  own.sort((a, b) => (b.count ?? 0) - (a.count ?? 0));
  const text = own.map(words.edge).join("; ");
  if (caption.textContent !== text) caption.textContent = text;
}

export function sweep(graph) {
  const { app, taken, circles, arrows, symbolOf } = graph, track = app.active;
  const now = track ? progress(app, track) : 0, active = track && symbolAt(track, now);
  taken.follow(track, now);
  for (const { label, node } of circles) node.classList.toggle("lit", symbolOf(label) === active);
  for (const edge of arrows) {
    const count = taken.count(edge.source, edge.target);
    if (edge.count !== count) write(graph, edge, count);
  }
  for (const circle of circles) name(graph, circle);
  if (graph.shown !== null) describe(graph);
}

/** Name a vertex by its edges: anew only where it has the focus. */
function name({ arrows, words }, { label, node }) {
  if (document.activeElement !== node && node.hasAttribute("aria-label")) return;
  const own = arrows.filter(edge => edge.source === label);
  node.setAttribute("aria-label", own.map(words.edge).join("; "));
}

/** Show how often an edge has been taken. */
function write({ app, words, layout }, edge, count) {
  const off = edge.possible === false && !count, times = app.data.loops ? `${whole(count)}×` : "";
  edge.count = count;
  edge.node.classList.toggle("taken", count > 0);
  edge.node.classList.toggle("off", off);
  edge.node.dataset.taken = count;
  edge.title.textContent = words.edge(edge);
  if (edge.beside) edge.beside.span.textContent = `${edge.beside.before}${times && `↻ ${times}`}`;
  if (!edge.path) return;
  edge.text.classList.toggle("taken", count > 0);
  edge.path.setAttribute("marker-end", `url(#tip${count ? "-taken" : off ? "-off" : ""})`);
  const full = layout.kind === "pair" || edge.source === edge.target;
  edge.lines[0].textContent = full ? words.cells(edge.target) : count ? times : "";
  edge.lines[1].textContent = full ? times : "";
}

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

/**
 * Return a counter of a track's transitions: {follow(track, now), count(source, target), all}.
 * Labels are those of the automaton; `last` is the default's.
 */
export function makeTaken(last) {
  const labelOf = symbol => (symbol < 0 ? last : symbol);
  let track = null, sample = 0, counts = new Map();

  /** Count up to a sample; another track, or going back, counts anew. */
  function follow(next, now) {
    const symbols = next?.symbols ?? [], stop = Math.min(now, symbols.length - 1);
    if (track !== next || stop < sample || !symbols.length) {
      [track, sample, counts] = [next, 0, new Map()];
    }
    for (let k = sample + 1; k <= stop; k++) {
      const key = `${labelOf(symbols[k - 1])}>${labelOf(symbols[k])}`;
      counts.set(key, (counts.get(key) ?? 0) + 1);
    }
    sample = Math.max(stop, 0);
  }

  return {
    follow,
    count: (source, target) => counts.get(`${source}>${target}`) ?? 0,
    /** How often each edge has been taken, by "source>target". */
    all: () => Object.fromEntries(counts),
  };
}
