import { byId } from "../dom/elements.js";
import { counted } from "../dom/text.js";

/** Show what the policy is called and how large it is, and hide what there is nothing for. */
export function showTitle({ data, loop }) {
  const n = data.domain.names.length, { classList } = document.body;
  byId("name").textContent = data.name;
  byId("summary").textContent = [
    counted(n, "state"),
    counted(data.symbols.length - 1, "symbol"),
    data.tree ? counted((data.tree.split.shape[0] + 1) / 2, "leaf", "leaves")
      : counted(data.automaton.vertices.reduce((sum, v) => sum + v.cells, 0), "cell"),
    data.statistics.solves && counted(data.statistics.solves, "solve"),
  ].filter(Boolean).join(" · ");
  classList.toggle("undrawn", !data.drawing);
  classList.toggle("flat", n === 1);
  classList.toggle("static", !loop);
  for (const id of ["player", "tracks", "series", "status", "settings"]) byId(id).hidden = !loop;
}
