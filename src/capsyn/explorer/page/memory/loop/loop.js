import { makeLoop as makePlainLoop } from "../../loop/loop.js";
import { NONE } from "../../policy/symbols.js";
import { makeHolds } from "./holds.js";

/**
 * Return the closed loop of a policy that remembers. It is as the other `makeLoop` says, but for
 * the defaults of `minDwell`, the policy's own least times, which null stands for, and of `delay`,
 * that which the policy compensates; and for what a trajectory tells beside: `held` (K),
 * `heldInputs` (K m) and `changes` (K), see `makeHolds`.
 */
export function makeLoop(data, lookup, model) {
  let holds = null;

  /** What is taken: the other loop, without a least time, takes what it is told. */
  function symbol(x, outside) {
    const seen = lookup.symbol(x, outside, holds.now());
    return seen.symbol === NONE ? seen : { ...seen, symbol: holds.take(seen.symbol, seen.status) };
  }

  const loop = makePlainLoop(data, { ...lookup, symbol }, model);

  function run(x0, options = {}) {
    const { rate = data.rate, delay = data.delay ?? 0, minDwell = null } = options;
    const { outsideAtOnce = data.outside_at_once ?? false } = options;
    holds = makeHolds(data, { rate, minDwell, outsideAtOnce });
    return { ...loop.run(x0, { ...options, delay, minDwell: 0 }), ...holds.told() };
  }

  return { ...loop, run };
}
