import { byId, element } from "../dom/elements.js";
import { MIXED } from "../policy/symbols.js";
import { showOnly } from "../state/changes.js";
import { swatch } from "../state/swatches.js";

/** Fill the legend: symbols, each of which shows its cells alone, the target, and mixed cells. */
export function showLegend(app) {
  const { data, loop, lookup, view } = app, root = byId("legend");
  const symbols = [...Array(data.symbols.length - 1).keys()];
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
  if (lookup.levels > 0) entry({ class: "later" }, swatch(MIXED), "still to split");
}
