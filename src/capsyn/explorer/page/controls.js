import { byId, element, short, whole, withUnit } from "./dom.js";

/** Speeds of the player, in seconds of the system per second where runs take about ten. */
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10];
const MOST_SAMPLES = 400_000, USUAL_SAMPLES = 60_000, MOST_STEPS = 10_000_000;

/** Usual duration [s] of a closed loop. */
const usualDuration = data =>
  Number(Math.min((data.horizon ?? 1) * 10, USUAL_SAMPLES / data.rate).toPrecision(1));

/** The power of ten by which runs are played faster, so that none takes hours. */
function pace(data) {
  const tens = Math.log10(usualDuration(data) / 10);
  return Math.abs(tens) <= 1 ? 1 : 10 ** Math.round(tens);
}

function labelled(text, control, ...more) {
  return element("label", {}, element("span", { title: text }, text), control, ...more);
}

/** The tools over the map, and sliders for the states that are not in its plane. */
export function makeMapTools(app) {
  const { data, view, lookup } = app, { names, units, lower, upper } = data.domain, n = names.length;
  const tools = byId("map-tools"), sliders = byId("sliders");
  const options = () => names.map((name, i) => element("option", { value: i }, name));
  const picker = side => element("select", {
    id: ["axis-x", "axis-y"][side],
    onchange: event => {
      view.choose(side, Number(event.target.value));
      app.changed();
    },
  }, options());
  const pickers = [picker(0), picker(1)];
  const level = element("input", {
    id: "level", type: "range", min: 0, max: lookup.levels, step: 1, value: view.level,
    oninput: () => show(Number(level.value)),
  });
  const levelText = element("output", { for: "level" });
  const outlines = element("input", {
    id: "outlines", type: "checkbox", checked: view.outlines,
    onchange: () => {
      view.outlines = outlines.checked;
      app.changed();
    },
  });
  const follow = element("input", {
    id: "follow", type: "checkbox", checked: n > 2, onchange: () => app.moved(),
  });
  const replay = element("button", { id: "replay", type: "button", onclick: () => play(0),
    title: "Algorithm 1, level by level" }, "Replay");
  const button = (text, title, onclick) =>
    element("button", { type: "button", class: "square", title, "aria-label": title, onclick }, text);
  let timer = null;

  function show(value) {
    clearTimeout(timer);
    view.level = Math.min(Math.max(value, 0), lookup.levels);
    app.changed();
  }

  function play(value) {
    show(value);
    if (value < lookup.levels) timer = setTimeout(() => play(value + 1), 800);
  }

  tools.append(...[
    n > 1 && labelled("across", pickers[0]),
    n > 1 && labelled("up", pickers[1]),
    lookup.levels > 0 && labelled("level", level, levelText),
    lookup.levels > 0 && replay,
    labelled("outlines", outlines),
  ].filter(Boolean));
  byId("zoom").append(
    button("+", "Zoom in", () => app.zoomed(0.7)),
    button("−", "Zoom out", () => app.zoomed(1 / 0.7)),
    button("⤢", "Show all", () => {
      view.reset();
      app.changed();
    }),
  );

  const rows = names.map((name, i) => {
    const input = element("input", {
      type: "range", id: `slice-${i}`, min: lower[i], max: upper[i], value: view.fixed[i],
      step: (upper[i] - lower[i]) / 200,
      oninput: () => {
        view.fixed[i] = Number(input.value);
        follow.checked = false;
        app.changed();
      },
    });
    const output = element("output", { for: `slice-${i}` });
    const row = labelled(withUnit(name, units[i]), input, output);
    sliders.append(row);
    return { row, input, output };
  });

  if (data.loops) sliders.append(labelled("follow the trajectory", follow));

  function sync() {
    pickers.forEach((select, side) => (select.value = String(view.axes[side])));
    level.value = String(view.level);
    levelText.textContent = `${view.level} of ${lookup.levels}`;
    outlines.checked = view.outlines;
    rows.forEach(({ row, input, output }, i) => {
      row.hidden = n < 3 || view.axes.includes(i);
      input.value = String(view.fixed[i]);
      output.textContent = short(view.fixed[i], 3);
    });
    sliders.hidden = n < 3;
  }

  return { sync, show, follows: () => follow.checked };
}

/** The bar of the player: play, reset, speed, and where it is. */
export function makePlayerBar(app) {
  const { player } = app, bar = byId("player"), unit = pace(app.data);
  player.speed = unit;
  const play = element("button", { id: "play", type: "button", class: "main", onclick: () => toggle() });
  const reset = element("button", { id: "reset", type: "button", onclick: () => rewind() }, "Reset");
  const speed = element("select", {
    id: "speed", onchange: () => (player.speed = Number(speed.value)),
  }, SPEEDS.map(v => element("option", { value: v * unit, selected: v === 1 }, `${short(v * unit)}×`)));
  const scrub = element("input", {
    id: "scrub", type: "range", min: 0, max: 1, step: 0.001, value: 0, "aria-label": "Time",
    oninput: () => player.seek(Number(scrub.value) * app.longest()),
  });
  const time = element("output", { id: "time" });
  bar.append(play, reset, labelled("speed", speed), scrub, time);

  const toggle = () => (player.playing ? player.pause() : player.play());
  function rewind() {
    player.pause();
    player.seek(0);
  }

  function sync() {
    const length = app.longest();
    play.textContent = player.playing ? "❚❚ Pause" : "▶ Play";
    for (const control of [play, reset, scrub]) control.disabled = !length;
    scrub.value = String(length ? player.time / length : 0);
    const digits = length ? Math.min(Math.max(3 - Math.ceil(Math.log10(length)), 0), 12) : 2;
    time.textContent = `${player.time.toFixed(digits)} s`;
    scrub.setAttribute("aria-valuetext", `${time.textContent} of ${short(length)} s`);
  }
  return { sync, toggle, rewind };
}

/** The settings of the closed loop: {options, summary}. */
export function makeSettings(app) {
  const { data } = app, box = byId("settings");
  const { lower, upper } = data.domain;
  const usual = usualDuration(data), problem = element("p", { id: "problem", role: "alert" });
  const fields = {};

  function field(name, text, unit, value, least, title) {
    fields[name] = element("input", {
      id: `set-${name}`, type: "number", value, min: least, step: "any", required: true, title,
      oninput: () => options(), onchange: () => app.rerun(), "data-name": text, "aria-describedby": "problem",
    });
    return labelled(text, fields[name], element("span", { class: "unit" }, unit));
  }

  const symbols = data.symbols.map((name, k) => {
    const value = k < data.symbols.length - 1 ? k : -1;
    return element("option", { value }, `symbol ${name}`);
  });
  const outside = element("select", { id: "set-outside", onchange: () => app.rerun() },
    ["error", "nearest"].map(rule => element("option", { value: rule },
      { error: "stop there", nearest: "nearest cell" }[rule])), symbols);
  outside.value = String(data.outside);
  const stop = element("input", { id: "set-stop", type: "checkbox", onchange: () => app.rerun() });
  const keep = element("input", { id: "keep", type: "checkbox" });

  box.append(...[
    field("duration", "duration", "s", usual, 0, "How long each trajectory is"),
    field("rate", "sample rate", "1/s", data.rate, 0, "How often the policy is asked"),
    field("noise", "noise", "%", 0, 0, "Standard deviation of the measured states, in % of their widths"),
    field("delay", "delay", "ms", 0, 0, "From a sample until its control acts"),
    field("dwell", "least dwell", "s", data.min_dwell, 0, "Least time between switches"),
    labelled("outside", outside),
    data.target && labelled("stop at target", stop),
    labelled("keep earlier", keep),
    problem,
  ].filter(Boolean));

  /** Mark the fields that are wrong, and say why. */
  function told(text, ...wrong) {
    for (const input of Object.values(fields)) {
      if (wrong.includes(input)) input.setAttribute("aria-invalid", "true");
      else input.removeAttribute("aria-invalid");
    }
    problem.textContent = text;
    document.body.classList.toggle("invalid", Boolean(text));
    return text;
  }

  /** Return options of the closed loop, or text that says what is wrong. */
  function options() {
    const given = {}, { duration, rate } = fields;
    for (const [name, input] of Object.entries(fields)) {
      const value = input.valueAsNumber, positive = input === duration || input === rate;
      if (!(positive ? value > 0 : value >= 0) || !Number.isFinite(value)) {
        return told(`${input.dataset.name} must be a number ${positive ? "above 0" : "from 0"}`, input);
      }
      given[name] = value;
    }
    const samples = given.duration * given.rate;
    if (samples < 1 || samples > MOST_SAMPLES) {
      return told(`duration × sample rate must be 1 to ${whole(MOST_SAMPLES)} samples`, duration, rate);
    }
    const { steps } = app.loop.substeps(given.rate);
    if (samples * steps > MOST_STEPS) {
      return told(`${whole(Math.round(samples))} samples of ${steps} integration steps would take too long`,
        duration, rate);
    }
    told("");
    const rule = outside.value;
    return {
      duration: given.duration,
      rate: given.rate,
      noise: lower.map((low, i) => (given.noise / 100) * (upper[i] - low)),
      delay: given.delay / 1000,
      minDwell: given.dwell,
      outside: rule === "error" || rule === "nearest" ? rule : Number(rule),
      stopAtTarget: stop.checked,
    };
  }

  /** Return in words what is unusual about options. */
  function summary(given) {
    const share = given.noise.length ? given.noise[0] / (upper[0] - lower[0]) : 0;
    return [
      given.rate !== data.rate && `${short(given.rate)} Hz`,
      share > 0 && `noise ${short(100 * share)} %`,
      given.delay > 0 && `delay ${short(given.delay * 1000)} ms`,
      given.minDwell !== data.min_dwell && `dwell ${short(given.minDwell)} s`,
      given.outside !== data.outside && `outside ${typeof given.outside === "string"
        ? given.outside : data.symbols.at(given.outside)}`,
    ].filter(Boolean).join(", ");
  }

  return { options, summary, keeps: () => keep.checked };
}
