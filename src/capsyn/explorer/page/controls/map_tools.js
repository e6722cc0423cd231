import { byId, element, labelled } from "../dom/elements.js";
import { short, withUnit } from "../dom/text.js";
import { look, moved, zoom } from "../state/changes.js";
import { makeTold } from "./told.js";

/** Time between the levels of a replay [ms]. */
const PAUSE = 800;

/**
 * Return the tools over the map: {sync, show, follows}. `show` goes to a level of Algorithm 1,
 * `follows` tells whether the plane goes with the active trajectory.
 */
export function makeMapTools(app) {
  const { data, view, lookup } = app, several = view.n > 1, replays = lookup.levels > 0;
  const axes = makeAxes(app), levels = makeLevels(app);
  const told = makeTold(app), slices = makeSlices(app);
  const [outlines, proved] = ["outlines", "proved"].map(id => makeSwitch(app, id));
  byId("map-tools").append(...[
    several && labelled("across", axes.pickers[0]),
    several && labelled("up", axes.pickers[1]),
    replays && labelled("level", levels.slider, levels.text),
    replays && levels.replay,
    labelled("outlines", outlines),
    data.proved && labelled("proved", proved),
  ].filter(Boolean));
  byId("zoom").append(
    button("+", "Zoom in", () => zoom(app, 0.7)),
    button("−", "Zoom out", () => zoom(app, 1 / 0.7)),
    button("⤢", "Show all", () => look(app, () => view.reset())),
  );

  function sync() {
    axes.sync();
    levels.sync();
    outlines.checked = view.outlines;
    proved.checked = view.proved;
    told.sync();
    slices.sync();
  }

  return { sync, show: levels.show, follows: slices.follows };
}

function button(text, title, onclick) {
  const attributes = { type: "button", class: "square", title, "aria-label": title, onclick };
  return element("button", attributes, text);
}

/** What turns something that a view may show on and off, by its name. */
function makeSwitch(app, id) {
  const { view } = app;
  const box = element("input", {
    id, type: "checkbox", checked: view[id],
    onchange: () => look(app, () => (view[id] = box.checked)),
  });
  return box;
}

/** Pickers of the states that span the plane. */
function makeAxes(app) {
  const { data, view } = app;
  const picker = side => element("select", {
    id: ["axis-x", "axis-y"][side],
    onchange: event => look(app, () => view.choose(side, Number(event.target.value))),
  }, data.domain.names.map((name, i) => element("option", { value: i }, name)));
  const pickers = [picker(0), picker(1)];
  const sync = () => pickers.forEach((select, side) => (select.value = String(view.axes[side])));
  return { pickers, sync };
}

/** The level of Algorithm 1: a slider, and a button that goes through all. */
function makeLevels(app) {
  const { view, lookup } = app;
  const slider = element("input", {
    id: "level", type: "range", min: 0, max: lookup.levels, step: 1, value: view.level,
    oninput: () => show(Number(slider.value)),
  });
  const text = element("output", { for: "level" });
  const replay = element("button", { id: "replay", type: "button", onclick: () => play(0),
    title: "Algorithm 1, level by level" }, "Replay");
  let timer = null;

  function show(value) {
    clearTimeout(timer);
    look(app, () => (view.level = Math.min(Math.max(value, 0), lookup.levels)));
  }

  function play(value) {
    show(value);
    if (value < lookup.levels) timer = setTimeout(() => play(value + 1), PAUSE);
  }

  function sync() {
    slider.value = String(view.level);
    text.textContent = `${view.level} of ${lookup.levels}`;
  }

  return { slider, text, replay, show, sync };
}

/** Sliders for the states that are not in the plane of the map: {sync, follows}. */
function makeSlices(app) {
  const { data, view } = app, { names, units, lower, upper } = data.domain, n = names.length;
  const root = byId("sliders");
  const follow = element("input", {
    id: "follow", type: "checkbox", checked: n > 2, onchange: () => moved(app),
  });

  const rows = names.slice(0, view.states).map((name, i) => {
    const input = element("input", {
      type: "range", id: `slice-${i}`, min: lower[i], max: upper[i], value: view.fixed[i],
      step: (upper[i] - lower[i]) / 200,
      oninput: () => {
        follow.checked = false;
        look(app, () => (view.fixed[i] = Number(input.value)));
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
      row.hidden = view.axes.includes(i);
      input.value = String(view.fixed[i]);
      output.textContent = short(view.fixed[i], 3);
    });
    root.hidden = rows.every(({ row }) => row.hidden);
  }

  return { sync, follows: () => follow.checked };
}
