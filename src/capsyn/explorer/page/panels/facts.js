import { byId, element } from "../dom/elements.js";
import { counted, short, withUnit } from "../dom/text.js";
import { MIXED } from "../policy/symbols.js";
import { showOnly } from "../state/changes.js";
import { swatch } from "../state/swatches.js";
import { choicePicture } from "./choice.js";

/** The legend has more symbols than these only where they occur. */
const FEW = 8;

/** Show what the policy is called and how large it is, and hide what there is nothing for. */
export function showTitle({ data, loop, view: { n, states } }) {
  const { classList } = document.body;
  byId("name").textContent = data.name;
  byId("summary").textContent = [
    counted(states, "state"),
    states < n && counted(n - states, "exogenous input"),
    counted(data.symbols.length - 1, "symbol"),
    data.tree ? counted(data.leaves, "leaf", "leaves") : counted(data.leaves, "cell"),
    data.statistics.solves && counted(data.statistics.solves, "solve"),
  ].filter(Boolean).join(" · ");
  classList.toggle("undrawn", !data.drawing);
  classList.toggle("flat", n === 1);
  classList.toggle("told", states < n);
  classList.toggle("static", !loop);
  for (const id of ["player", "tracks", "series", "status", "settings"]) byId(id).hidden = !loop;
}

/**
 * Fill the legend: symbols, each of which shows its cells alone, the target, where the running cost
 * is least, what is proved, and mixed cells.
 */
export function showLegend(app) {
  const { data, loop, lookup, view } = app, root = byId("legend");
  const used = new Set(data.automaton.vertices.map(({ symbol }) => symbol));
  const all = [...Array(data.symbols.length - 1).keys()];
  const symbols = all.length > FEW ? all.filter(symbol => used.has(symbol)) : all;
  if (data.shares.at(-1) > 0) symbols.push(-1);
  const entry = (more, ...content) =>
    root.append(element("span", { role: "listitem", ...more }, ...content));
  for (const symbol of symbols) {
    entry({}, element("button", {
      type: "button", class: "key", title: "Show only its cells", "data-symbol": symbol,
      onpointerenter: () => showOnly(app, symbol), onpointerleave: () => showOnly(app, null),
      onfocus: () => showOnly(app, symbol), onblur: () => showOnly(app, null),
    }, swatch(symbol), data.symbols.at(symbol)));
  }
  if (loop && data.target && view.n > 1) {
    entry({ title: data.target.text }, element("span", { class: "line" }), "target");
  }
  if (loop && view.states < view.n) {
    entry({ class: "goal", title: "The fiftieth of the slice where the running cost is least" },
      element("span", { class: "line" }), "least running cost");
  }
  if (data.proved) {
    for (const name of ["open", "refuted", "stays in", "ripple"]) {
      const mark = element("span", { class: `mark ${name.split(" ")[0]}` });
      entry({ class: "proof" }, mark, name);
    }
  }
  if (lookup.levels > 0) entry({ class: "later" }, swatch(MIXED), "still to split");
}

/** Fill the facts of the page: tables of the states and symbols, and sections of rows. */
export function showFacts(app) {
  const { data, view } = app, { names, units, lower, upper, periodic } = data.domain;
  const { inputs, units: inputUnits } = data.alphabet;
  const card = (title, ...content) =>
    element("section", { class: "card fact" }, element("h2", {}, title), ...content);

  const axes = (title, one, ...bounds) => card(title, table(
    [one, "from", "to", "finest cells"],
    names.map((name, i) => [
      withUnit(name, units[i]) + (periodic[i] ? " ↻" : ""), short(lower[i]), short(upper[i]),
      data.counts[i].toLocaleString("en-US"),
    ]).slice(...bounds),
  ), periodic.slice(...bounds).some(Boolean)
    ? element("p", { class: "note" }, "↻ periodic") : null);
  const boxes = [axes("States", "state", 0, view.states)];
  if (view.states < view.n) boxes.push(axes("Exogenous inputs", "told", view.states));

  const symbols = card("Symbols", table(
    ["symbol", ...inputs.map((name, i) => withUnit(name, inputUnits[i])), "share"],
    data.symbols.map((name, k) => {
      const index = k < data.symbols.length - 1 ? k : -1;
      return [[swatch(index), name], ...data.controls[k].map(v => short(v)),
        `${(100 * data.shares[k]).toFixed(2)} %`];
    }).filter((_, k) => k < data.symbols.length - 1 || data.shares[k] > 0),
  ), data.shares.at(-1) > 0 ? null : element("p", { class: "note" },
    `Default control: ${data.controls.at(-1).map(v => short(v)).join(", ")}` +
    `${data.law ? ", its law's in the middle" : ""}; no cell has it.`));

  const sections = data.facts.map(({ title, rows, table: [head, ...body] = [], points = [] }) => {
    const section = card(
      title,
      title === "Solves" ? bar(data.statistics) : null,
      element("dl", {}, rows.flatMap(([name, text]) => [
        element("dt", {}, name), element("dd", name ? {} : { class: "wide" }, text),
      ])),
      head ? table(head, body) : null,
      choicePicture(points),
    );
    section.classList.toggle("broad", Boolean(head));
    return section;
  });
  byId("facts").prepend(...boxes, symbols, ...sections);
  const formulas = byId("formulas");
  formulas.hidden = !formulas.querySelector("math");
}

function table(head, rows) {
  const cells = (tag, row) =>
    element("tr", {}, row.map(text => element(tag, {}, ...[text].flat())));
  return element("div", { class: "scroll" }, element("table", {},
    element("thead", {}, cells("th", head)),
    element("tbody", {}, rows.map(row => cells("td", row)))));
}

/** The solves as a share of the paper's worst case. */
function bar({ solves, worst_case_solves: worst }) {
  if (!solves || !worst) return null;
  const done = element("span");
  done.style.width = `${Math.max(0.5, (100 * solves) / worst)}%`;
  return element("div", { class: "bar", title: "solves as a share of the worst case" }, done);
}
