import { byId, element } from "../../dom/elements.js";
import { makeReadout as makePlainReadout } from "../../panels/readout.js";
import { DEFAULT } from "../../policy/symbols.js";
import { paintSwatches, swatch } from "../../state/swatches.js";

/** Up to so many symbols in force, each is told by itself. */
const FEW = 4;

/** Return the text of what is at the state that is pointed at, see the other `makeReadout`. */
export function makeReadout(app) {
  const readout = makePlainReadout(app), root = byId("readout");

  function draw() {
    readout.draw();
    const cell = app.pointed?.cell;
    if (!cell || !app.lookup.remembers) return;
    const name = one => app.data.symbols.at(one), row = rowOf(app.data, cell.row);
    const before = now => (now === DEFAULT ? "start" : name(now));
    const symbols = [...new Set(app.data.memory.in_force.map(label => cell.row[label]))];
    if (!cell.mixed) root.querySelector(".allowed .quiet").textContent = "";
    root.querySelector(".allowed").after(element("div", { class: "row" }, element("dt", {}, "next"),
      element("dd", {}, grouped(row, before).flatMap(([now, next], k) =>
        [`${k ? ", " : ""}${now} → `, swatch(next), name(next)]))));
    if (app.lookup.shown === null && symbols.length > 1) {
      root.querySelector(".symbol dd").replaceChildren(
        element("span", { class: "swatches" }, symbols.map(swatch)), symbols.map(name).join(" or "));
    }
    paintSwatches(app.theme);
  }

  return { draw };
}

/** Pairs of what may be in force, the start last, and what follows it. */
function rowOf({ memory, symbols }, row) {
  const last = symbols.length - 1;
  return [...memory.in_force.filter(label => label < last).map(label => [label, row[label]]),
    [DEFAULT, row[last]]];
}

/** The pairs with names of what is in force: of many those with the same next symbol together. */
function grouped(row, name) {
  if (row.length <= FEW) return row.map(([now, next]) => [name(now), next]);
  const groups = new Map();
  for (const [now, next] of row) groups.set(next, [...(groups.get(next) ?? []), name(now)]);
  const found = [...groups].sort(([, a], [, b]) => a.length - b.length);
  return found.map(([next, names], k) => [
    k < found.length - 1 ? names.join(", ") : k ? "others" : "any", next]);
}
