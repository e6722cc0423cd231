import { INSIDE, NONE, NOT_FINITE, unpack } from "./lookup.js";

const MOST_SAMPLES = 1e7;

/**
 * Return the closed loop of a policy with its model: {rate, run, substeps}.
 *
 * `data` is that of `policy_data`, `lookup` that of `makeLookup`, `model` that of
 * `model_javascript`. What happens at a sample is told in `capsyn.closed_loop`.
 *
 * run(x0, {duration, rate, noise, seed, delay, minDwell, outside, substeps, stopAtTarget}): the
 * trajectory from a state, all of it at once. Defaults are the policy's own, with no noise (a
 * standard deviation [state units], or one per state) and no delay [s], for 5 s. It is
 * {t (K+1), x (K+1, n), u (K, m), symbols (K), cost (K+1), terminalCost, totalCost, ended, arrived,
 * switches, outside, rate, substeps}: K samples until it ended, matrices row by row; `ended` is
 * "time", "target", "left the domain" or "not finite"; `arrived` [s] is NaN if it did not.
 *
 * substeps(rate): {steps, resolved}, the Runge-Kutta steps per sample that `choose_substeps` in
 * `capsyn.plant` takes, and whether their error is as small as it should be.
 */
export function makeLoop(data, lookup, model) {
  const { n } = lookup, { controls } = data, m = controls[0].length;
  const widths = data.domain.lower.map((low, i) => data.domain.upper[i] - low);
  const sampled = unpack(data.sampled.states), count = sampled.length / n;
  const controlOf = symbol => controls[symbol < 0 ? controls.length - 1 : symbol];
  const [k1, k2, k3, k4, y] = Array.from({ length: 5 }, () => new Float64Array(n));
  const [c1, c2, c3, c4] = Array.from({ length: 4 }, () => new Float64Array(1));

  function differ(one, other) {
    const u = controlOf(one), v = controlOf(other);
    for (let i = 0; i < m; i++) if (u[i] !== v[i]) return true;
    return false;
  }

  function isFinite(x) {
    for (let i = 0; i < n; i++) if (!Number.isFinite(x[i])) return false;
    return true;
  }

  function along(x, factor, h, k) {
    for (let i = 0; i < n; i++) y[i] = x[i] + factor * h * k[i];
  }

  /** Move a state and its cost on by the classical Runge-Kutta method. */
  function advance(x, cost, u, duration, steps) {
    const h = duration / steps;
    for (let s = 0; s < steps; s++) {
      model.dynamics(x, u, k1);
      model.runningCost(x, c1);
      along(x, 0.5, h, k1);
      model.dynamics(y, u, k2);
      model.runningCost(y, c2);
      along(x, 0.5, h, k2);
      model.dynamics(y, u, k3);
      model.runningCost(y, c3);
      along(x, 1, h, k3);
      model.dynamics(y, u, k4);
      model.runningCost(y, c4);
      for (let i = 0; i < n; i++) x[i] += (h / 6) * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
      cost[0] += (h / 6) * (c1[0] + 2 * c2[0] + 2 * c3[0] + c4[0]);
    }
  }

  const chosen = new Map();
  function substeps(rate) {
    if (!chosen.has(rate)) chosen.set(rate, choose(1 / rate));
    return chosen.get(rate);
  }

  function choose(period) {
    const ends = new Map(), cost = new Float64Array(1);
    const end = steps => {
      if (!ends.has(steps)) {
        const states = sampled.slice();
        for (let s = 0; s < count; s++) {
          const x = states.subarray(s * n, (s + 1) * n);
          advance(x, cost, controls[s % controls.length], period, steps);
        }
        ends.set(steps, states.map((x, k) => x / widths[k % n]));
      }
      return ends.get(steps);
    };
    const errorOf = steps => {
      const coarse = end(steps), fine = end(2 * steps), errors = [];
      for (let s = 0; s < count; s++) {
        let error = 0, finite = true;
        for (let k = s * n; k < (s + 1) * n; k++) {
          const off = Math.abs(fine[k] - coarse[k]);
          error = Math.max(error, Number.isFinite(off) ? off : Infinity);
          finite &&= Number.isFinite(fine[k]);
        }
        if (error < Infinity || finite) errors.push(error);
      }
      return percentile95(errors);
    };
    const allowed = data.sampled.accuracy * period, { unresolved, most } = data.sampled;
    let best = 1, least = Infinity, stalled = 0;
    for (let steps = 1; steps < most && stalled < 3; steps *= 2) {
      const error = errorOf(steps);
      if (error <= allowed) return { steps, resolved: true };
      stalled = error < 0.7 * least || error > unresolved ? 0 : stalled + 1;
      if (error <= least || least > unresolved) [best, least] = [steps, error];
    }
    return { steps: best, resolved: false };
  }

  function run(x0, {
    duration = 5, rate = data.rate, noise = 0, seed = 0, delay = 0, minDwell = data.min_dwell,
    outside = data.outside, substeps: given = null, stopAtTarget = false,
  } = {}) {
    const samples = roundEven(duration * rate), period = 1 / rate;
    if (!(samples >= 1 && samples <= MOST_SAMPLES)) {
      throw new RangeError(`duration times rate must be 1 to ${MOST_SAMPLES}; got ${samples}`);
    }
    if (x0.length !== n) throw new RangeError(`a state is ${n} numbers; got ${x0.length}`);
    const steps = given ?? substeps(rate).steps;
    const dwell = Math.ceil(Math.min(minDwell * rate - 1e-9, samples));
    const late = Math.min(delay, samples * period), whole = Math.floor(late / period + 1e-9);
    const left = late - whole * period, rest = left < 1e-9 * period ? 0 : left;
    const now = period - rest, before = period - now;
    const deviations = widths.map((_, i) => (typeof noise === "number" ? noise : noise[i]));
    const normal = deviations.some(d => d !== 0) ? gaussian(seed) : null;

    const t = new Float64Array(samples + 1), cost = new Float64Array(samples + 1);
    const states = new Float64Array((samples + 1) * n), u = new Float64Array(samples * m);
    const symbols = new Int16Array(samples);
    const x = Float64Array.from(x0), gathered = new Float64Array(1), inside = new Float64Array(1);
    const measured = new Float64Array(n);
    let symbol = NONE, held = 0, switches = 0, away = 0, arrived = NaN, ended = null, k = 0;

    /** The control that acts at sample k: what was decided at an earlier one, or the default. */
    const acting = sample => (sample < 0 ? controlOf(-1) : controlOf(symbols[sample]));

    for (; ; k++) {
      t[k] = k / rate;
      states.set(x, k * n);
      cost[k] = gathered[0];
      if (!isFinite(x)) {
        ended = "not finite";
        break;
      }
      model.inside(x, inside);
      if (inside[0] !== 0 && Number.isFinite(inside[0])) {
        if (Number.isNaN(arrived)) arrived = k / rate;
        if (stopAtTarget) {
          ended = "target";
          break;
        }
      }
      if (k === samples) {
        ended = "time";
        break;
      }
      for (let i = 0; i < n; i++) measured[i] = x[i] + (normal ? deviations[i] * normal() : 0);
      const seen = lookup.symbol(measured, outside);
      if (seen.status !== INSIDE) away += 1;
      if (seen.symbol === NONE) {
        ended = seen.status === NOT_FINITE ? "not finite" : "left the domain";
        break;
      }
      const first = symbol === NONE, changes = first || differ(seen.symbol, symbol);
      if (first || (changes && held >= dwell)) {
        if (!first) switches += 1;
        held = 0;
      }
      if (held === 0 || !changes) symbol = seen.symbol;
      held += 1;
      symbols[k] = symbol;
      u.set(controlOf(symbol), k * m);
      if (rest > 0) advance(x, gathered, acting(k - whole - 1), before, steps);
      advance(x, gathered, acting(k - whole), now, steps);
    }
    const terminal = new Float64Array(1);
    model.terminalCost(x, terminal, new Float64Array(n));
    return {
      t: t.slice(0, k + 1),
      x: states.slice(0, (k + 1) * n),
      u: u.slice(0, k * m),
      symbols: symbols.slice(0, k),
      cost: cost.slice(0, k + 1),
      terminalCost: terminal[0],
      totalCost: gathered[0] + terminal[0],
      ended,
      arrived,
      switches,
      outside: away,
      rate,
      substeps: steps,
    };
  }

  return { rate: data.rate, run, substeps };
}

/** The 95th percentile between order statistics; infinite where it is not finite. */
function percentile95(values) {
  if (!values.length) return Infinity;
  const sorted = Float64Array.from(values).sort(), place = 0.95 * (sorted.length - 1);
  const below = sorted[Math.floor(place)], above = sorted[Math.ceil(place)];
  const value = below + (above - below) * (place % 1);
  return Number.isFinite(value) ? value : Infinity;
}

function roundEven(x) {
  const nearest = Math.round(x);
  return x % 1 === 0.5 && nearest % 2 ? nearest - 1 : nearest;
}

/** A source of standard normal numbers: splitmix of 32 bits, and Marsaglia's polar method. */
function gaussian(seed) {
  let state = seed >>> 0, spare = null;
  const uniform = () => {
    state = (state + 0x9e3779b9) >>> 0;
    let z = state;
    z = Math.imul(z ^ (z >>> 16), 0x85ebca6b);
    z = Math.imul(z ^ (z >>> 13), 0xc2b2ae35);
    return ((z ^ (z >>> 16)) >>> 0) / 2 ** 32;
  };
  return () => {
    if (spare !== null) {
      const value = spare;
      spare = null;
      return value;
    }
    for (;;) {
      const a = 2 * uniform() - 1, b = 2 * uniform() - 1, square = a * a + b * b;
      if (square > 0 && square < 1) {
        const factor = Math.sqrt((-2 * Math.log(square)) / square);
        spare = b * factor;
        return a * factor;
      }
    }
  };
}
