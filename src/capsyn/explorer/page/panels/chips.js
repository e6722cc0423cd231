import { byId, element } from "../dom/elements.js";
import { counted, short, timeUnit } from "../dom/text.js";
import { choose, drop } from "../state/trajectories.js";

const ENDS = {
  time: "ran to the end", target: "reached the target", "left the domain": "left the domain",
  "not finite": "is no longer finite",
};

/** Return the tracks as chips, and the active one in words: {draw, sweep}. */
export function makeChips(app) {
  const root = byId("tracks");

  function draw() {
    const focused = document.activeElement?.closest(".chip")?.dataset.number;
    byId("status").textContent =
      app.active ? sentence(app, app.active) : "Click a state on the map.";
    const chips = app.tracks.map(track => chipOf(app, track));
    root.replaceChildren(...chips);
    if (focused) (chips.find(chip => chip.dataset.number === focused) ?? chips.at(-1))
      ?.querySelector(".choose").focus();
  }

  /** Mark the tracks that are over. */
  function sweep() {
    for (const chip of root.children) {
      const track = app.tracks.find(one => String(one.number) === chip.dataset.number);
      if (track) chip.classList.toggle("done", app.player.time >= track.t.at(-1));
    }
  }

  return { draw, sweep };
}

function chipOf(app, track) {
  const badge = element("span", { class: "badge" }, String(track.number));
  badge.style.setProperty("--track", app.theme.track(track.color));
  const { states } = app.view, active = track === app.active;
  const from = track.start.slice(0, states).map(v => short(v, 3)).join(", ");
  const told = app.data.domain.names.slice(states)
    .map((name, k) => `${name} ${short(track.start[states + k])}`).join(", ");
  const words = [told && told + (track.told.length ? " at first" : ""), track.words];
  const cost = `Cost of all of it, eq. (3): ${short(track.cost.at(-1))} while running and ` +
    `${short(track.terminalCost)} at the end`;
  const chip = element("span", { class: "chip", role: "listitem", "data-number": track.number },
    element("button", { type: "button", class: "choose", title: "Make it the active one",
      "aria-pressed": String(active), onclick: () => choose(app, track) },
    badge, element("span", {}, `from (${from})`),
    words.some(Boolean) ? element("small", {}, words.filter(Boolean).join(", ")) : null,
    element("span", { class: "cost", title: cost }, `J ${short(track.totalCost)}`)),
    element("button", { type: "button", class: "drop", title: "Remove",
      "aria-label": `Remove trajectory ${track.number}`, onclick: () => drop(app, track) }, "×"));
  chip.classList.toggle("active", active);
  return chip;
}

/** How a track went. */
function sentence({ data, loop }, track) {
  const unit = timeUnit(data), at = `${short(track.t.at(-1))} ${unit}`;
  return [
    `Trajectory ${track.number} ${ENDS[track.ended]}` +
      (track.ended === "time" ? ` (${at})` : ` at ${at}`),
    counted(track.switches, "switch", "switches"),
    data.target && (Number.isNaN(track.arrived) ? "target not reached"
      : `target first reached at ${short(track.arrived)} ${unit}`),
    track.outside > 0 && `${counted(track.outside, "sample")} outside`,
    !loop.substeps(track.rate).resolved && "integration not resolved: raise the sample rate",
  ].filter(Boolean).join(" · ");
}
