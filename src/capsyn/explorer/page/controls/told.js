import { byId, element, labelled } from "../dom/elements.js";
import { short, withUnit } from "../dom/text.js";
import { changed } from "../state/changes.js";
import { tell, waits } from "../state/trajectories.js";

/** Least steps of a slider. */
const STEPS = 100;

/**
 * Return the sliders of the exogenous inputs, which act at once on the map and on the active
 * trajectory: {sync}.
 */
export function makeTold(app) {
  const { data, view } = app;
  if (view.states === view.n) return { sync() {} };
  const { names, units } = data.domain;
  const note = element("span", {
    class: "quiet", role: "status", title: "The trajectory that is shown is over",
  });
  const rows = names.slice(view.states).map((name, k) => {
    const i = view.states + k, id = `told-${k}`;
    const input = element("input", {
      type: "range", id, min: view.lower[i], max: view.upper[i], value: view.fixed[i],
      step: stepOf(view.width(i)),
      oninput: () => {
        view.fixed[i] = Number(input.value);
        tell(app);
        changed(app);
      },
    });
    return { i, input, output: element("output", { for: id }) };
  });
  byId("sliders").before(element("section", { id: "told", "aria-labelledby": "told-title" },
    element("p", {}, element("span", { id: "told-title" }, "told to the controller"), note),
    rows.map(({ i, input, output }) => labelled(withUnit(names[i], units[i]), input, output))));

  function sync() {
    for (const { i, input, output } of rows) {
      input.value = String(view.fixed[i]);
      output.textContent = short(view.fixed[i]);
    }
    note.textContent = waits(app) ? "from the next start on" : "";
  }

  return { sync };
}

/** A round step that goes into a width, else a part of it. */
function stepOf(width) {
  const power = 10 ** Math.floor(Math.log10(width / STEPS));
  const round = [5, 2, 1].map(k => k * power).find(step =>
    step * STEPS <= width && Math.abs(width / step - Math.round(width / step)) < 1e-9);
  return round === undefined ? width / (2 * STEPS) : Number(round.toPrecision(1));
}
