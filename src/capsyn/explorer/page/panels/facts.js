import { byId, element } from "../dom/elements.js";
import { short, withUnit } from "../dom/text.js";
import { swatch } from "../state/swatches.js";

/** Fill the facts of the page: tables of the states and symbols, and sections of rows. */
export function showFacts(app) {
  const { data } = app, { names, units, lower, upper, periodic } = data.domain;
  const { inputs, units: inputUnits } = data.alphabet;
  const card = (title, ...content) =>
    element("section", { class: "card fact" }, element("h2", {}, title), ...content);

  const states = card("States", table(
    ["state", "from", "to", "finest cells"],
    names.map((name, i) => [
      withUnit(name, units[i]) + (periodic[i] ? " ↻" : ""), short(lower[i]), short(upper[i]),
      data.counts[i].toLocaleString("en-US"),
    ]),
  ), periodic.some(Boolean) ? element("p", { class: "note" }, "↻ periodic") : null);

  const symbols = card("Symbols", table(
    ["symbol", ...inputs.map((name, i) => withUnit(name, inputUnits[i])), "share"],
    data.symbols.map((name, k) => {
      const index = k < data.symbols.length - 1 ? k : -1;
      return [[swatch(index), name], ...data.controls[k].map(v => short(v)),
        `${(100 * data.shares[k]).toFixed(2)} %`];
    }).filter((_, k) => k < data.symbols.length - 1 || data.shares[k] > 0),
  ), data.shares.at(-1) > 0 ? null : element("p", { class: "note" },
    `Default control: ${data.controls.at(-1).map(v => short(v)).join(", ")}; no cell has it.`));

  const sections = data.facts.map(({ title, rows }) => card(
    title,
    title === "Solves" ? bar(data.statistics) : null,
    element("dl", {}, rows.flatMap(([name, text]) => [
      element("dt", {}, name), element("dd", name ? {} : { class: "wide" }, text),
    ])),
  ));
  byId("facts").prepend(states, symbols, ...sections);
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
