import { byId, element, labelled } from "../dom/elements.js";
import { short, timeUnit, whole } from "../dom/text.js";
import { rerun } from "../state/trajectories.js";
import { usualDuration } from "./pace.js";

const MOST_SAMPLES = 400_000, MOST_STEPS = 10_000_000;
/** Numbers: their name, unit with that of time in place of T, and what they are. */
const FIELDS = {
  duration: ["duration", "T", "How long each trajectory is"],
  rate: ["sample rate", "1/T", "How often the policy is asked"],
  noise: ["noise", "%", "Standard deviation of the measured states, in % of their widths"],
  delay: ["delay", "T", "From a sample until its control acts"],
  dwell: ["least dwell", "T", "Least time between switches"],
};
/** The unit that a delay is given in, and how many of it the unit of time has. */
const delayUnit = unit => (unit === "s" ? ["ms", 1000] : [unit, 1]);
/** Those that must be above 0. */
const POSITIVE = ["duration", "rate"];

/**
 * Return the settings of the closed loop: {options, summary, keeps}. `options()` are those of `run`
 * of `makeLoop`, or text that says what is wrong; `summary(options)` says what is unusual about
 * them; `keeps()` tells whether earlier trajectories stay.
 */
export function makeSettings(app) {
  const { data } = app, form = {
    app, fields: {}, problem: element("p", { id: "problem", role: "alert" }),
    outside: makeOutside(app),
    atOnce: element("input", {
      id: "set-at-once", type: "checkbox", checked: data.outside_at_once ?? false,
      title: "Whether the symbol of a state outside does not wait for the least dwell",
      onchange: () => rerun(app),
    }),
    stop: element("input", { id: "set-stop", type: "checkbox", onchange: () => rerun(app) }),
    keep: element("input", { id: "keep", type: "checkbox" }),
  };
  const { rate, min_dwell: dwell } = data;
  const values = { duration: usualDuration(data), rate, noise: 0, delay: 0, dwell };
  byId("settings").classList.toggle("wide", timeUnit(data) !== "s");
  byId("settings").append(...[
    ...Object.keys(FIELDS).map(name => makeField(form, name, values[name])),
    labelled("outside", form.outside),
    labelled("outside at once", form.atOnce),
    data.target && labelled("stop at target", form.stop),
    labelled("keep earlier", form.keep),
    form.problem,
  ].filter(Boolean));
  return {
    options: () => optionsOf(form),
    summary: options => summary(options, data),
    keeps: () => form.keep.checked,
  };
}

function makeField(form, name, value) {
  const [text, kind, title] = FIELDS[name], time = timeUnit(form.app.data);
  const unit = name === "delay" ? delayUnit(time)[0] : kind.replace("T", time);
  const input = form.fields[name] = element("input", {
    id: `set-${name}`, type: "number", value, min: 0, step: "any", required: true, title,
    oninput: () => optionsOf(form), onchange: () => rerun(form.app), "data-name": text,
    "aria-describedby": "problem", disabled: name === "rate" && form.app.data.discrete === true,
  });
  return labelled(text, input, element("span", { class: "unit" }, unit));
}

/** A picker of the rule outside the domain. */
function makeOutside(app) {
  const { symbols, outside } = app.data;
  const rules = Object.entries({ error: "stop there", nearest: "nearest cell" });
  const picker = element("select", { id: "set-outside", onchange: () => rerun(app) },
    rules.map(([value, text]) => element("option", { value }, text)),
    symbols.map((name, k) =>
      element("option", { value: k < symbols.length - 1 ? k : -1 }, `symbol ${name}`)));
  picker.value = String(outside);
  return picker;
}

/** Mark the fields that are wrong, and say why; return the text. */
function complain({ fields, problem }, text, ...wrong) {
  for (const [name, input] of Object.entries(fields)) {
    if (wrong.includes(name)) input.setAttribute("aria-invalid", "true");
    else input.removeAttribute("aria-invalid");
  }
  problem.textContent = text;
  document.body.classList.toggle("invalid", Boolean(text));
  return text;
}

function optionsOf(form) {
  const { app, fields, outside, atOnce, stop } = form, { lower, upper, states } = app.view;
  const values = {};
  for (const [name, input] of Object.entries(fields)) {
    const value = input.valueAsNumber, positive = POSITIVE.includes(name);
    if (!(positive ? value > 0 : value >= 0) || !Number.isFinite(value)) {
      const text = `must be a number ${positive ? "above 0" : "from 0"}`;
      return complain(form, `${input.dataset.name} ${text}`, name);
    }
    values[name] = value;
  }
  const { duration, rate, noise, delay, dwell } = values, samples = duration * rate;
  if (samples < 1 || samples > MOST_SAMPLES) {
    const text = `duration × sample rate must be 1 to ${whole(MOST_SAMPLES)} samples`;
    return complain(form, text, ...POSITIVE);
  }
  const late = delay / delayUnit(timeUnit(app.data))[1];
  if (app.data.discrete && Math.abs(late * rate - Math.round(late * rate)) > app.data.slack) {
    return complain(form, "delay must be whole samples of the discrete-time model", "delay");
  }
  const { steps } = app.loop.substeps(rate);
  if (samples * steps > MOST_STEPS) {
    const size = `${whole(Math.round(samples))} samples of ${steps} integration steps`;
    return complain(form, `${size} would take too long`, ...POSITIVE);
  }
  complain(form, "");
  const rule = outside.value;
  return {
    duration,
    rate,
    noise: lower.map((low, i) => (i < states ? (noise / 100) * (upper[i] - low) : 0)),
    delay: late,
    minDwell: dwell,
    outside: rule === "error" || rule === "nearest" ? rule : Number(rule),
    outsideAtOnce: atOnce.checked,
    stopAtTarget: stop.checked,
  };
}

function summary({ rate, noise, delay, minDwell, outside, outsideAtOnce }, data) {
  const unit = timeUnit(data), [late, parts] = delayUnit(unit);
  const { lower, upper } = data.domain;
  const rule = typeof outside === "string" ? outside : data.symbols.at(outside);
  const share = noise.length ? noise[0] / (upper[0] - lower[0]) : 0;
  return [
    rate !== data.rate && `${short(rate)} ${unit === "s" ? "Hz" : `1/${unit}`}`,
    share > 0 && `noise ${short(100 * share)} %`,
    delay > 0 && `delay ${short(delay * parts)} ${late}`,
    minDwell !== data.min_dwell && `dwell ${short(minDwell)} ${unit}`,
    outside !== data.outside && `outside ${rule}`,
    outsideAtOnce !== (data.outside_at_once ?? false) &&
      `outside ${outsideAtOnce ? "at once" : "waits"}`,
  ].filter(Boolean).join(", ");
}
