import { byId, element, labelled } from "../dom/elements.js";
import { short, withUnit } from "../dom/text.js";
import { changed, moved } from "../state/changes.js";

/** Return sliders for the states that are not in the plane of the map: {sync, follows}. */
export function makeSlices(app) {
  const { data, view } = app, { names, units, lower, upper } = data.domain, n = names.length;
  const root = byId("sliders");
  const follow = element("input", {
    id: "follow", type: "checkbox", checked: n > 2, onchange: () => moved(app),
  });

  const rows = names.map((name, i) => {
    const input = element("input", {
      type: "range", id: `slice-${i}`, min: lower[i], max: upper[i], value: view.fixed[i],
      step: (upper[i] - lower[i]) / 200,
      oninput: () => {
        view.fixed[i] = Number(input.value);
        follow.checked = false;
        changed(app);
      },
    });
    const output = element("output", { for: `slice-${i}` });
    const row = labelled(withUnit(name, units[i]), input, output);
    root.append(row);
    return { row, input, output };
  });
  if (data.loops) root.append(labelled("follow the trajectory", follow));

  function sync() {
    rows.forEach(({ row, input, output }, i) => {
      row.hidden = n < 3 || view.axes.includes(i);
      input.value = String(view.fixed[i]);
      output.textContent = short(view.fixed[i], 3);
    });
    root.hidden = n < 3;
  }

  return { sync, follows: () => follow.checked };
}
