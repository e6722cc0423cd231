import { byId, element, labelled } from "../dom/elements.js";
import { short, timeUnit } from "../dom/text.js";
import { longest } from "../state/tracks.js";
import { play as playOn } from "../state/trajectories.js";
import { pace } from "./pace.js";

/** Speeds of the player, in time of the system per second where runs take about ten. */
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10];

/** Return the bar of the player, {sync, toggle, rewind}: play, reset, speed, and where it is. */
export function makePlayerBar(app) {
  const { player } = app, usual = pace(app.data), unit = timeUnit(app.data);
  const speedText = v => (unit === "s" ? `${short(v)}×` : `${short(v)} ${unit}/s`);
  player.speed = usual;
  const toggle = () => (player.playing ? player.pause() : playOn(app));
  const rewind = () => {
    player.pause();
    player.seek(0);
  };
  const play = element("button", { id: "play", type: "button", class: "main", onclick: toggle });
  const reset = element("button", { id: "reset", type: "button", onclick: rewind }, "Reset");
  const speed = element("select", {
    id: "speed", onchange: () => (player.speed = Number(speed.value)),
  }, SPEEDS.map(v =>
    element("option", { value: v * usual, selected: v === 1 }, speedText(v * usual))));
  const scrub = element("input", {
    id: "scrub", type: "range", min: 0, max: 1, step: 0.001, value: 0, "aria-label": "Time",
    oninput: () => player.seek(Number(scrub.value) * longest(app.tracks)),
  });
  const time = element("output", { id: "time" });
  byId("player").append(play, reset, labelled("speed", speed), scrub, time);

  function sync() {
    const length = longest(app.tracks);
    play.textContent = player.playing ? "❚❚ Pause" : "▶ Play";
    for (const control of [play, reset, scrub]) control.disabled = !length;
    scrub.value = String(length ? player.time / length : 0);
    const digits = length ? Math.min(Math.max(3 - Math.ceil(Math.log10(length)), 0), 12) : 2;
    time.textContent = `${player.time.toFixed(digits)} ${unit}`;
    scrub.setAttribute("aria-valuetext", `${time.textContent} of ${short(length)} ${unit}`);
  }
  return { sync, toggle, rewind };
}
