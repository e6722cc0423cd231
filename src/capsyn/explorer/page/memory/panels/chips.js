import { makeChips as makePlainChips } from "../../panels/chips.js";
import { makeTimers } from "./timers.js";

/** Return the tracks as chips, see the other `makeChips`, and the timers of the active one. */
export function makeChips(app) {
  const chips = makePlainChips(app);
  if (!app.loop) return chips;
  const timers = makeTimers(app);
  const both = name => () => {
    chips[name]();
    timers.draw();
  };
  return { draw: both("draw"), sweep: both("sweep") };
}
