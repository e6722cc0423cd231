import { unpack } from "../policy/packed.js";

/**
 * Return a function of the sample rate: {steps, resolved}, the Runge-Kutta steps per sample that
 * `choose_substeps` in `capsyn.simulation.plant` takes, and whether their error is as small as it
 * should be. `widths` (n) are those of the domain, `advance` is that of `makeAdvance`.
 */
export function makeSubsteps({ sampled, controls }, widths, advance) {
  const n = widths.length, starts = unpack(sampled.states), chosen = new Map();

  /** Where the states, row by row, are after a period, in widths of the domain. */
  function scaledEnds(period, steps) {
    const states = starts.slice(), cost = new Float64Array(1);
    for (let s = 0; s * n < states.length; s++) {
      const x = states.subarray(s * n, (s + 1) * n);
      advance(x, cost, controls[s % controls.length], period, steps);
    }
    return states.map((x, k) => x / widths[k % n]);
  }

  function choose(period) {
    const ends = new Map(), tolerance = sampled.accuracy * period;
    const end = steps => {
      if (!ends.has(steps)) ends.set(steps, scaledEnds(period, steps));
      return ends.get(steps);
    };
    const errorOf = steps =>
      percentile(differences(end(steps), end(2 * steps), n), sampled.percentile);
    const { steps, error } = fewestSteps(sampled, errorOf, tolerance);
    return { steps, resolved: error <= tolerance };
  }

  return rate => {
    if (!chosen.has(rate)) chosen.set(rate, choose(1 / rate));
    return chosen.get(rate);
  };
}

/** The greatest differences of the states' components; infinite where only `fine` is finite. */
function differences(coarse, fine, n) {
  const errors = [];
  for (let first = 0; first < fine.length; first += n) {
    let error = 0, finite = true;
    for (let k = first; k < first + n; k++) {
      const off = Math.abs(fine[k] - coarse[k]);
      error = Math.max(error, Number.isFinite(off) ? off : Infinity);
      finite &&= Number.isFinite(fine[k]);
    }
    if (error < Infinity || finite) errors.push(error);
  }
  return errors;
}

/** See `fewest_steps` in `capsyn.programs.step_doubling`: {steps, error}. */
function fewestSteps({ ladder, falling, stalls, unresolved }, errorOf, tolerance) {
  let best = { steps: ladder[0], error: Infinity }, stalled = 0;
  for (const steps of ladder) {
    const error = errorOf(steps);
    if (error <= tolerance) return { steps, error };
    stalled = error < falling * best.error || error > unresolved ? 0 : stalled + 1;
    if (error <= best.error || best.error > unresolved) best = { steps, error };
    if (stalled === stalls) break;
  }
  return best;
}

/** A percentile between order statistics; infinite where it is not finite. */
function percentile(values, percent) {
  if (!values.length) return Infinity;
  const sorted = Float64Array.from(values).sort(), place = (percent / 100) * (sorted.length - 1);
  const below = sorted[Math.floor(place)], above = sorted[Math.ceil(place)];
  const value = below + (above - below) * (place % 1);
  return Number.isFinite(value) ? value : Infinity;
}
