import { makeSettings as makePlainSettings } from "../../controls/settings.js";
import { byId, element, labelled } from "../../dom/elements.js";
import { timeUnit } from "../../dom/text.js";
import { rerun } from "../../state/trajectories.js";

/**
 * Return the settings of the closed loop, see the other `makeSettings`. The delay is at first that
 * which the policy compensates. Outside the domain, no symbol can be chosen to which a transition is
 * forbidden. Where symbols or inputs have least times of their own, a box tells whether these hold
 * instead of one for all.
 */
export function makeSettings(app) {
  const settings = makePlainSettings(app), { data } = app;
  const { holds, input_holds: inputs, forbidden } = data.memory;
  const delay = byId("set-delay"), dwell = byId("set-dwell");
  if (data.delay) delay.value = data.delay * (timeUnit(data) === "s" ? 1000 : 1);
  for (const option of byId("set-outside").options) {
    option.disabled = forbidden.some(row => row.at(Number(option.value)));
  }
  const several = holds.some(time => time !== holds[0]) || inputs.some(time => time > 0);
  if (!several) return settings;
  const own = element("input", {
    id: "set-own", type: "checkbox", checked: true, title: "Symbols and inputs have their own",
    onchange: () => {
      dwell.disabled = own.checked;
      rerun(app);
    },
  });
  dwell.disabled = true;
  dwell.closest("label").after(labelled("own least times", own));

  function options() {
    const chosen = settings.options();
    return own.checked && typeof chosen === "object" ? { ...chosen, minDwell: null } : chosen;
  }

  const summary = chosen =>
    settings.summary({ ...chosen, minDwell: chosen.minDwell ?? data.min_dwell });

  return { ...settings, options, summary };
}
