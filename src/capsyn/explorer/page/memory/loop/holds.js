import { INSIDE, NONE, NOT_FINITE } from "../../policy/symbols.js";

/**
 * Return the symbol in force of a closed loop, and how long it and its inputs have been held; what
 * happens at a sample is told in `capsyn.simulation.closed_loop`: {take, told, now}.
 *
 * `data` is that of `policy_data`; options are those of `run` of `makeLoop`, minDwell null for the
 * policy's own least times. `take(wanted, status)` is asked once a sample and returns the symbol
 * that is taken; `now()` that in force, NONE before the first; `told()` is of all samples (K) so far
 * {held, heldInputs (K m), changes, switches}: in samples, this one included, how long symbol and
 * inputs have been held, and how many switches there have been.
 */
export function makeHolds({ controls, memory, slack }, { rate, minDwell, outsideAtOnce }) {
  const last = controls.length - 1, { kinds, forbidden } = memory;
  const own = (minDwell ?? null) === null, whole = time => Math.ceil(time * rate - slack);
  const holds = memory.holds.map(time => whole(own ? time : minDwell));
  const inputHolds = memory.input_holds.map(time => whole(own ? time : 0));
  const heldInputs = inputHolds.map(() => 0), record = { held: [], heldInputs: [], changes: [] };
  let now = null, held = 0, switches = 0;

  /** The label that is taken while `now` is in force and another is wanted. */
  function permitted(wanted) {
    if (held < holds[now] || forbidden[now][wanted]) return now;
    const control = controls[wanted].map((value, i) =>
      (heldInputs[i] < inputHolds[i] ? controls[now][i] : value));
    if (same(control, controls[wanted])) return wanted;
    if (same(control, controls[now])) return now;
    for (let label = 0; label < last; label++) {
      if (same(control, controls[label]) && !forbidden[now][label]) return label;
    }
    return now;
  }

  function take(symbol, status) {
    const first = now === null, wanted = symbol < 0 ? last : symbol;
    const atOnce = status === NOT_FINITE || (status !== INSIDE && outsideAtOnce);
    const next = first || atOnce || kinds[wanted] === kinds[now] ? wanted : permitted(wanted);
    const switched = !first && kinds[next] !== kinds[now];
    held = first || switched ? 1 : held + 1;
    switches += switched ? 1 : 0;
    controls[next].forEach((value, i) => {
      heldInputs[i] = first || value !== controls[now][i] ? 1 : heldInputs[i] + 1;
    });
    now = next;
    record.held.push(held);
    record.heldInputs.push(...heldInputs);
    record.changes.push(switches);
    return symbolOf(now);
  }

  const symbolOf = label => (label === last ? -1 : label);
  const told = () => ({ ...record, switches });
  return { take, told, now: () => (now === null ? NONE : symbolOf(now)) };
}

function same(u, v) {
  return u.every((value, i) => value === v[i]);
}
