import { INSIDE, NONE, NOT_FINITE } from "../policy/symbols.js";
import { gaussian } from "./noise.js";
import { makeMapStep } from "./map_step.js";
import { makeAdvance } from "./runge_kutta.js";
import { makeSubsteps } from "./substeps.js";

const MOST_SAMPLES = 1e7;

/**
 * Return the closed loop of a policy with its model: {rate, run, substeps}.
 *
 * `data` is that of `policy_data`, `lookup` that of `makeLookup`, `model` that of
 * `model_javascript`. What happens at a sample is told in `capsyn.simulation.closed_loop`.
 *
 * run(x0, {duration, rate, noise, seed, delay, minDwell, outside, outsideAtOnce, substeps,
 * stopAtTarget, exogenous}): the trajectory from a state, all of it at once, times in the policy's
 * unit. Exogenous inputs come after the states in x; pairs [time, values] of `exogenous`, in order,
 * change them at the first sample that is not before.
 * Defaults are the policy's own, with no noise (a standard deviation [state units], or one per
 * state) and no delay, for a time of 5. It is {t (K+1), x (K+1, n), u (K, m), symbols (K),
 * cost (K+1), terminalCost, totalCost, ended, arrived, switches, outside, rate, substeps}: K
 * samples until it ended, matrices row by row; `ended` is "time", "target", "left the domain" or
 * "not finite"; `arrived` is NaN if it did not.
 *
 * substeps(rate): see `makeSubsteps`. A map takes one step a sample, at its own rate, and a delay of
 * whole samples.
 */
export function makeLoop(data, lookup, model) {
  const widths = data.domain.lower.map((low, i) => data.domain.upper[i] - low);
  const advance = (data.discrete ? makeMapStep : makeAdvance)(model, lookup.n);
  const substeps = data.discrete
    ? () => ({ steps: 1, resolved: true })
    : makeSubsteps(data, widths, advance, model.kinks);
  const system = { data, lookup, model, widths, advance, substeps };
  return { rate: data.rate, run: (x0, options) => run(system, x0, options), substeps };
}

function run(system, x0, options = {}) {
  const settings = settled(system, x0, options), course = begun(system, x0, settings);
  for (let k = 0; ; k++) {
    tell(course, settings, k);
    record(course, settings, k);
    course.ended = arrival(system, course, settings, k) ?? decide(system, course, settings, k);
    if (course.ended) return result(system, course, settings, k);
    act(system, course, settings, k);
  }
}

/** The options of a run, whole numbers of samples where they are to be. */
function settled({ data, lookup: { n }, widths, substeps: choose }, x0, {
  duration = 5, rate = data.rate, noise = 0, seed = 0, delay = 0, minDwell = data.min_dwell,
  outside = data.outside, outsideAtOnce = data.outside_at_once ?? false, substeps = null,
  stopAtTarget = false, exogenous = [],
}) {
  const samples = roundEven(duration * rate), period = 1 / rate, { slack } = data;
  if (!(samples >= 1 && samples <= MOST_SAMPLES)) {
    throw new RangeError(`duration times rate must be 1 to ${MOST_SAMPLES}; got ${samples}`);
  }
  if (x0.length !== n) throw new RangeError(`a state is ${n} numbers; got ${x0.length}`);
  const late = Math.min(delay, samples * period), whole = Math.floor(late / period + slack);
  const left = late - whole * period, rest = left < slack * period ? 0 : left, now = period - rest;
  if (data.discrete && (rate !== data.rate || rest > 0)) {
    throw new RangeError("a map has its own rate, and a delay of whole samples");
  }
  const deviations = widths.map((_, i) => (typeof noise === "number" ? noise : noise[i]));
  return {
    samples, rate, outside, outsideAtOnce, stopAtTarget, deviations,
    steps: substeps ?? choose(rate).steps,
    dwell: Math.ceil(Math.min(minDwell * rate - slack, samples)),
    /** Samples that a control is late by, and from a sample the time until it acts and after it. */
    whole, rest, before: period - now, now,
    normal: deviations.some(d => d !== 0) ? gaussian(seed) : null,
    changes: exogenous.map(([time, values]) => [Math.ceil(time * rate - slack), values]),
  };
}

/** A trajectory at its start: what is recorded of it, and where it is. */
function begun({ data, lookup: { n } }, x0, { samples }) {
  return {
    t: new Float64Array(samples + 1), cost: new Float64Array(samples + 1),
    states: new Float64Array((samples + 1) * n), symbols: new Int16Array(samples),
    u: new Float64Array(samples * data.controls[0].length),
    x: Float64Array.from(x0), gathered: new Float64Array(1), measured: new Float64Array(n),
    inside: new Float64Array(1), symbol: NONE, held: 0, switches: 0, away: 0,
    arrived: NaN, ended: null, changed: 0,
  };
}

/** Change the exogenous inputs that are to change at sample k. */
function tell(course, { changes }, k) {
  for (; changes[course.changed]?.[0] <= k; course.changed++) {
    const values = changes[course.changed][1];
    course.x.set(values, course.x.length - values.length);
  }
}

function record({ t, states, cost, x, gathered }, { rate }, k) {
  t[k] = k / rate;
  states.set(x, k * x.length);
  cost[k] = gathered[0];
}

/** Look where a trajectory is at sample k; return why it ends there, or null. */
function arrival({ model }, course, { samples, rate, stopAtTarget }, k) {
  const { x, inside } = course;
  if (!x.every(Number.isFinite)) return "not finite";
  model.inside(x, inside);
  if (inside[0] !== 0 && Number.isFinite(inside[0])) {
    if (Number.isNaN(course.arrived)) course.arrived = k / rate;
    if (stopAtTarget) return "target";
  }
  return k === samples ? "time" : null;
}

/** Measure the state at sample k, ask the policy; return why the trajectory ends there, or null. */
function decide({ data, lookup }, course, settings, k) {
  const { x, measured } = course, { outside, deviations, normal } = settings;
  for (let i = 0; i < x.length; i++) measured[i] = x[i] + (normal ? deviations[i] * normal() : 0);
  const seen = lookup.symbol(measured, outside);
  if (seen.status !== INSIDE) course.away += 1;
  if (seen.symbol === NONE) return seen.status === NOT_FINITE ? "not finite" : "left the domain";
  const first = course.symbol === NONE;
  const changes = first || differ(data.controls.at(seen.symbol), data.controls.at(course.symbol));
  if (first || (changes && !waits(course, settings, seen.status))) {
    if (!first) course.switches += 1;
    course.held = 0;
  }
  if (course.held === 0 || !changes) course.symbol = seen.symbol;
  course.held += 1;
  course.symbols[k] = course.symbol;
  const control = data.controls.at(course.symbol);
  course.u.set(control, k * control.length);
  return null;
}

/** Return whether a control waits until that in force has been held for the dwell time. */
function waits({ held }, { dwell, outsideAtOnce }, status) {
  const atOnce = status === NOT_FINITE || (status !== INSIDE && outsideAtOnce);
  return !atOnce && held < dwell;
}

/** Go on to the next sample under the controls that act: decided before, or the default. */
function act({ data, advance }, { x, gathered, symbols }, { whole, rest, before, now, steps }, k) {
  const acting = sample => data.controls.at(sample < 0 ? -1 : symbols[sample]);
  if (rest > 0) advance(x, gathered, acting(k - whole - 1), before, steps);
  advance(x, gathered, acting(k - whole), now, steps);
}

function result({ data, model }, course, { rate, steps }, k) {
  const { t, x, states, u, symbols, cost, gathered, ended, arrived, switches, away } = course;
  const terminal = new Float64Array(1);
  model.terminalCost(x, terminal, new Float64Array(x.length));
  return {
    t: t.slice(0, k + 1),
    x: states.slice(0, (k + 1) * x.length),
    u: u.slice(0, k * data.controls[0].length),
    symbols: symbols.slice(0, k),
    cost: cost.slice(0, k + 1),
    terminalCost: terminal[0],
    totalCost: gathered[0] + terminal[0],
    ended, arrived, switches, outside: away, rate, substeps: steps,
  };
}

function differ(u, v) {
  return u.some((value, i) => value !== v[i]);
}

function roundEven(x) {
  const nearest = Math.round(x);
  return x % 1 === 0.5 && nearest % 2 ? nearest - 1 : nearest;
}
