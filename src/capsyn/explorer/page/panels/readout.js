import { byId, element } from "../dom/elements.js";
import { short, tickText, unitText, whole } from "../dom/text.js";
import { MIXED, NONE } from "../policy/symbols.js";
import { paintSwatches, swatch } from "../state/swatches.js";

/** Return the text of what is at the state that is pointed at: {draw}. */
export function makeReadout(app) {
  return {
    draw() {
      const rows = app.pointed ? rowsOf(app, app.pointed)
        : [["state", "point at the map, or move the cursor with the arrow keys"]];
      byId("readout").replaceChildren(...rows.map(([name, ...content]) =>
        element("div", { class: name }, element("dt", {}, name), element("dd", {}, ...content))));
      paintSwatches(app.theme);
    },
  };
}

/** Rows: a name and what stands beside it. */
function rowsOf({ data, view }, { state, symbol, cell }) {
  const later = cell && cell.level > view.level, final = later ? "final " : "";
  const quiet = text => element("span", { class: "quiet" }, text);
  const name = one => (one === NONE ? "none" : data.symbols.at(one));
  const { domain } = data, part = (...bounds) =>
    values(domain.names.slice(...bounds), domain.units.slice(...bounds), state.slice(...bounds));
  const rows = [["state", part(0, view.states)]];
  if (view.states < view.n) rows.push(["told", part(view.states)]);
  if (later) rows.push(["then", swatch(MIXED), `still to split at level ${view.level}`]);
  const { inputs, units } = data.alphabet;
  rows.push(["symbol", swatch(symbol), final, name(symbol), symbol === NONE ? ""
    : quiet(` ${values(inputs, units, data.controls.at(symbol))}`)]);
  if (!cell) return [...rows, ["cell", "outside the domain"]];
  rows.push(["allowed", ...cell.allowed.flatMap(one => [swatch(one), `${name(one)} `]),
    quiet(cell.allowed.length > 1 ? "mixed" : "")]);
  const depth = `${data.tree ? "depth" : "level"} ${cell.level}`;
  return [...rows, ["cell", `${final}${whole(cell.leaf)}, ${depth}: ${box(cell)}`]];
}

function values(names, units, numbers) {
  return names.map((name, i) => {
    const text = short(numbers[i]);
    return `${name} = ${units[i] ? `${text} ${unitText(units[i])}` : text}`;
  }).join(", ");
}

function box({ lower, upper }) {
  if (!lower) return "cut by oblique splits";
  return lower.map((low, i) => {
    const ends = [low, upper[i]];
    return `[${ends.map(tickText(ends)).join(", ")}]`;
  }).join(" × ");
}
