import { byId, element } from "../../dom/elements.js";
import { counted, short, timeUnit, whole } from "../../dom/text.js";
import { progress, symbolAt } from "../../state/tracks.js";
import { paintSwatches, swatch } from "../../state/swatches.js";

/**
 * Return what shows how long the symbol in force, and each input that has a least time, have been
 * held at the present of the active track, and how often it has switched by then: {draw}.
 */
export function makeTimers(app) {
  const root = element("dl", { id: "timers", "aria-label": "In force" });
  byId("settings").before(root);
  return {
    draw() {
      root.hidden = !app.active;
      if (!app.active) return;
      root.replaceChildren(...rowsOf(app, app.active).flatMap(([name, content, timer]) =>
        [element("dt", {}, name), element("dd", {}, content), element("dd", {}, timer)]));
      paintSwatches(app.theme);
    },
  };
}

/** Rows: a name, what is in force, and its time. */
function rowsOf(app, track) {
  const { data } = app, { memory, alphabet } = data, unit = timeUnit(data);
  const sample = Math.min(progress(app, track), track.symbols.length - 1);
  if (sample < 0) return [];
  const symbol = symbolAt(track, sample), own = track.options.minDwell === null;
  const time = Math.min(app.player.time, track.t.at(-1));
  /** The time of what has been held for so many samples, and how much of its least time it is. */
  const timer = (held, least) => {
    const since = Math.max(0, time - (sample + 1 - held) / track.rate);
    const bar = element("span", { class: "done" });
    bar.style.width = `${least > 0 ? Math.min(100, (100 * since) / least) : 100}%`;
    return [least > 0 ? element("span", { class: "bar" }, bar) : null,
      `for ${short(since, 3)} ${unit}${least > 0 ? ` of at least ${short(least)} ${unit}` : ""}`];
  };
  const least = own ? memory.holds.at(symbol) : track.options.minDwell;
  const inputs = alphabet.inputs.map((name, i) => {
    const held = track.heldInputs[sample * alphabet.inputs.length + i];
    return own && memory.input_holds[i] > 0 &&
      [name, short(data.controls.at(symbol)[i]), timer(held, memory.input_holds[i])];
  });
  return [
    ["in force", [swatch(symbol), data.symbols.at(symbol)], timer(track.held[sample], least)],
    ...inputs.filter(Boolean),
    ["so far", counted(track.changes[sample], "switch", "switches"), `of ${whole(track.switches)}`],
  ];
}
