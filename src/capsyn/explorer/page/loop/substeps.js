import { unpack } from "../policy/packed.js";

/**
 * Return a function of the sample rate: {steps, resolved}, the Runge-Kutta steps per sample that
 * `choose_substeps` in `capsyn.simulation.plant` takes, and whether their error is as small as it
 * should be. `widths` (n) are those of the domain, `advance` is that of `makeAdvance`, `kinks` that of
 * the model.
 */
export function makeSubsteps({ sampled, controls }, widths, advance, kinks) {
  const n = widths.length, starts = unpack(sampled.states), chosen = new Map();

  /** Call `visit` with a copy of each sampled state, its control, its number. */
  function each(visit) {
    const states = starts.slice();
    for (let s = 0; s * n < states.length; s++)
      visit(states.subarray(s * n, (s + 1) * n), controls[s % controls.length], s);
  }

  /** Where the states are after a period, in widths of the domain, and what it cost. */
  function ends(period, steps) {
    const states = [], costs = [];
    each((x, u) => {
      const cost = new Float64Array(1);
      advance(x, cost, u, period, steps);
      states.push(x.map((value, k) => value / widths[k]));
      costs.push(cost[0]);
    });
    return { states, costs };
  }

  /** What the errors of the states count: less where the model has a kink on the way. */
  function weights(period) {
    const found = [], first = new Float64Array(sampled.sides), sides = first.slice();
    each((x, u) => {
      kinks(x, u, first);
      let met = false;
      for (let piece = 0; piece < sampled.pieces; piece++) {
        advance(x, [0], u, period / sampled.pieces, 1);
        kinks(x, u, sides);
        met ||= sides.some((side, k) => side !== first[k]);
      }
      found.push(met ? sampled.kinked : 1);
    });
    return found;
  }

  function choose(period) {
    const known = new Map(), tolerance = sampled.accuracy * period, weight = weights(period);
    const end = steps => {
      if (!known.has(steps)) known.set(steps, ends(period, steps));
      return known.get(steps);
    };
    const paid = period / sampled.cost_accuracy;
    const errorOf = steps =>
      percentile(differences(end(steps), end(2 * steps), paid, weight), sampled.percentile);
    const { steps, error } = fewestSteps(sampled, errorOf, tolerance);
    return { steps, resolved: error <= tolerance };
  }

  return rate => {
    if (!chosen.has(rate)) chosen.set(rate, choose(1 / rate));
    return chosen.get(rate);
  };
}

/**
 * The greatest differences of the states' components, or of the costs relative to their mean, times
 * `paid`, all times a weight; infinite where only `fine` is finite.
 */
function differences(coarse, fine, paid, weight) {
  const errors = [], known = fine.costs.filter(Number.isFinite);
  const usual = known.reduce((sum, cost) => sum + Math.abs(cost), 0) / known.length;
  fine.states.forEach((end, s) => {
    const off = [...end].map((value, k) => Math.abs(value - coarse.states[s][k]));
    if (usual > 0) off.push((Math.abs(fine.costs[s] - coarse.costs[s]) / usual) * paid);
    const error = off.every(Number.isFinite) ? Math.max(...off) : Infinity;
    if (error < Infinity || end.every(Number.isFinite)) errors.push(weight[s] * error);
  });
  return errors;
}

/** See `fewest_steps` in `capsyn.programs.step_doubling`: {steps, error}. */
function fewestSteps({ ladder, falling, stalls, tried, unresolved }, errorOf, tolerance) {
  let best = { steps: ladder[0], error: Infinity }, stalled = 0;
  for (const steps of ladder) {
    const error = errorOf(steps);
    if (error <= tolerance) return { steps, error };
    const falls = error < falling * best.error || error > unresolved || steps < tried;
    stalled = falls ? 0 : stalled + 1;
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
