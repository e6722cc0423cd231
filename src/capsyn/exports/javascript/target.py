"""Target ``javascript``: one ES module without dependencies, for Node and browsers.

The rule of the lattice is the source text that the explorer's page uses too.
"""

from __future__ import annotations

import json
import textwrap
from importlib import resources

from capsyn.exports.constants import constants, tables
from capsyn.exports.feature_texts import features_of, javascript_ranks
from capsyn.exports.golden import Golden
from capsyn.exports.identifiers import file_name
from capsyn.exports.plan import Plan
from capsyn.exports.target import Exported, NameOption, Target
from capsyn.exports.text import spoken

QUANTISE = """
/** Return the lattice steps of a state of finite numbers; beyond the bounds the nearest. */
export function quantise(state) {
  return COUNTS.map((count, i) => latticeStep(state[i], LOWER[i], UPPER[i], PERIODIC[i], count));
}
"""
DECIDE = """
/** Return [symbol, status] of a state: an index into CONTROLS, and OK, OUTSIDE or NOT_FINITE. */
export function decide(state) {
"""
NEXT = """
/**
 * Return [symbol, status]: what follows a symbol in force at a state, DEFAULT at first. They are an
 * index into CONTROLS, as that in force is, and OK, OUTSIDE or NOT_FINITE.
 */
export function next(inForce, state) {
  if (!(inForce in CONTROLS)) throw new RangeError(`a symbol in force is 0 to ${DEFAULT}`);
"""
STEPS = """\
  if (state.length !== LOWER.length) throw new RangeError(`a state is ${LOWER.length} numbers`);
  const x = LOWER.map((_, i) => state[i] * SCALE[i] + OFFSET[i]);
  for (let i = 0; i < x.length; i++) {
    if (!Number.isFinite(state[i]) || !Number.isFinite(x[i])) return [SAFE, NOT_FINITE];
  }
  const inside = x.every((v, i) => PERIODIC[i] || (v >= LOWER[i] && v <= UPPER[i]));
  if (!inside && !NEAREST) return [SAFE, OUTSIDE];
  const z = quantise(x);
"""
WALK = """\
  let i = 0;
  while (SPLIT[i] >= 0) {
    let value = z[SPLIT[i]];
    if (SPLIT[i] >= z.length) {
      const plane = PLANES[SPLIT[i] - z.length];
      value = 0;
      for (let j = 0; j < z.length; j++) value += plane[j] * z[j];
    }
    i = value >= THRESHOLD[i] ? SECOND[i] : i + 1;
  }
"""
"""Through the nodes of a tree."""
LABEL = """\
  if (THRESHOLD[i] === GAP) return [SAFE, OUTSIDE];
  return [THRESHOLD[i], inside ? OK : OUTSIDE];
}
"""
SYMBOL = """\
  if (symbol === GAP) return [SAFE, OUTSIDE];
  return [symbol, inside ? OK : OUTSIDE];
}
"""
CONTROL = """
/** Return the control vector of a state [input units]. */
export function control(state) {
  return CONTROLS[decide(state)[0]];
}
"""
SAME_FOR_ALL = """
/** Return `decide` of a state: here the symbol in force does not matter. */
export function next(inForce, state) {
  return decide(state);
}
"""
CONTROLLER = """
/** The policy with a least time between switches, MIN_DWELL by default [time unit]. */
export class Controller {
  constructor(minDwell = MIN_DWELL) {
    this.minDwell = minDwell;
    this.reset();
  }

  /** Forget what is held: the next step takes its symbol at once. */
  reset() {
    this.symbol = null;
    this.since = 0;
  }

  /**
   * Return [symbol, status] at a time [time unit]; a control is held for minDwell before another.
   * Times do not decrease; a millionth of the dwell time is allowed for their rounding. The symbol
   * of a state whose status is in AT_ONCE does not wait, and is held anew.
   */
  step(state, time) {
    const [symbol, status] = decide(state);
    const same = this.symbol !== null &&
      CONTROLS[symbol].every((v, i) => v === CONTROLS[this.symbol][i]);
    if (same) {
      this.symbol = symbol;
    } else if (this.symbol === null || AT_ONCE.includes(status) ||
        time - this.since >= this.minDwell * (1 - 1e-6)) {
      this.symbol = symbol;
      this.since = time;
    }
    return [this.symbol, status];
  }
"""
REMEMBERING = """
/**
 * The symbol in force from step to step, and what its change waits for [time unit]. A symbol is
 * held once it is entered, an input once it has changed, and SAFE is in force for the time holdOff
 * after the first step.
 */
export class Controller {
  constructor(holds = HOLDS, inputHolds = INPUT_HOLDS, holdOff = HOLD_OFF) {
    this.holds = holds;
    this.inputHolds = inputHolds;
    this.holdOff = holdOff;
    this.reset();
  }

  /** Forget what is in force: the next step is the first. */
  reset() {
    this.symbol = null;
    this.start = this.since = 0;
    this.changes = INPUTS.map(() => 0);
  }

  /**
   * Return [symbol, status] at a time [time unit]: the symbol in force, and the state's status.
   * Times do not decrease; a millionth of each least time is allowed for their rounding. The symbol
   * of a state whose status is in AT_ONCE does not wait, and is held anew.
   */
  step(state, TIME) {
    const first = this.symbol === null;
    const now = first ? DEFAULT : this.symbol;
    let [symbol, status] = next(now, state);
    if (first) this.start = time;
    if (time - this.start < this.holdOff * (1 - 1e-6)) symbol = SAFE;
    if (!first && !AT_ONCE.includes(status) && KINDS[symbol] !== KINDS[now]) {
      symbol = this.#permitted(symbol, time);
    }
    if (first || KINDS[symbol] !== KINDS[now]) this.since = time;
    CONTROLS[symbol].forEach((value, i) => {
      if (first || value !== CONTROLS[now][i]) this.changes[i] = time;
    });
    this.symbol = symbol;
    return [symbol, status];
  }

  /**
   * Return what is taken where another symbol than that in force is wanted. Inputs whose time is
   * not over keep their values, if a symbol that may follow has these; where no other is left to
   * change, the symbol in force stays.
   */
  #permitted(wanted, time) {
    const now = this.symbol;
    if (time - this.since < this.holds[now] * (1 - 1e-6)) return now;
    const mixed = CONTROLS[wanted].map((value, i) =>
      time - this.changes[i] < this.inputHolds[i] * (1 - 1e-6) ? CONTROLS[now][i] : value);
    const has = (symbol) => CONTROLS[symbol].every((value, i) => value === mixed[i]);
    if (has(wanted)) return wanted;
    if (has(now)) return now;
    for (let symbol = 0; symbol < DEFAULT; symbol++) {
      if (has(symbol) && !FORBIDDEN.some(([j, k]) => j === now && k === symbol)) return symbol;
    }
    return now;
  }
"""
HELD = """
  /** Return the control vector that is held [input units]; the default before any step. */
  control() {
    return CONTROLS[this.symbol === null ? DEFAULT : this.symbol];
  }
}
"""
LEAF = """
/** Return the number of the leaf that holds lattice steps. */
function leaf(z) {
  const size = Array.from(ROOT_SIZES);
  let at = 0;
  for (let i = 0; i < z.length; i++) at = at * PARTITIONS[i] + Math.floor(z[i] / size[i]);
  while (ENTRIES[at] >= 0) {
    let child = 0;
    for (let i = 0; i < z.length; i++) {
      if (SPLITS.length && !((SPLITS[at] >> i) & 1)) continue;
      size[i] /= REFINEMENT[i];
      child = child * REFINEMENT[i] + (Math.floor(z[i] / size[i]) % REFINEMENT[i]);
    }
    at = ENTRIES[at] + child;
  }
  return -1 - ENTRIES[at];
}
"""
LARGEST = """
/** Return the symbol of a leaf at lattice steps: of equal rows that of the first. */
function largest(leaf, z) {
  if (leaf <= DEFAULT) return leaf;
  const place = leaf - DEFAULT - 1;
  let best = 0, most = -Infinity;
  for (let row = ROW_STARTS[place]; row < ROW_STARTS[place + 1]; row++) {
    let value = ROW_CONSTANTS[row];
    for (let i = 0; i < z.length; i++) value += ROW_SLOPES[row * z.length + i] * z[i];
    if (value > most) {
      most = value;
      best = ROW_SYMBOLS[row];
    }
  }
  return best;
}
"""
FOLLOWING = """
/**
 * Return the symbol that follows that in force in a leaf at lattice steps. A row counts less by the
 * price of its symbol. Of equals that in force comes first.
 */
function following(leaf, z, inForce) {
  if (leaf < TRANSITIONS.length) return TRANSITIONS[leaf][inForce];
  const place = leaf - TRANSITIONS.length;
  let best = inForce, most = -Infinity;
  for (let row = ROW_STARTS[place]; row < ROW_STARTS[place + 1]; row++) {
    const ratio = ROW_RATIOS[inForce * (DEFAULT + 1) + ROW_SYMBOLS[row]];
    let value = ROW_CONSTANTS[row] - ROW_PRICES[place] * ratio;
    for (let i = 0; i < z.length; i++) value += ROW_SLOPES[row * z.length + i] * z[i];
    if (ratio < 0 || value < most) continue;
    if (value > most || ROW_SYMBOLS[row] === inForce) best = ROW_SYMBOLS[row];
    most = value;
  }
  return best;
}
"""
"""Functions of the module, and parts of them."""


def export(plan: Plan, golden: Golden, options: NameOption) -> Exported:
    """Return an ES module, ``NAME.mjs``."""
    lines = [*(f"// {line}" for line in plan.header), ""]
    for constant, value, note in constants(plan):
        lines += [f"// {note}"] * bool(note)
        lines.append(f"export const {constant} = {json.dumps(value)};")
    for constant, value, note in tables(plan):
        lines += [f"// {note}", f"const {constant} ="]
        lines += textwrap.wrap(f"{json.dumps(value)};", 100)
    lattice = resources.files("capsyn.exports.javascript").joinpath("lattice.js").read_text("utf-8")
    code = spoken(plan.policy, _code(plan)).replace("[time unit]", f"[{plan.policy.time_unit}]")
    if features := features_of(plan.cells):
        code = javascript_ranks(features) + code.replace("quantise(x)", "withRanks(quantise(x))")
    text = "\n".join([*lines, "", lattice]) + code
    return Exported({f"{file_name(options.name, plan.policy.name)}.mjs": text.encode()})


def _code(plan: Plan) -> str:
    """Return the functions."""
    remembers = plan.policy.remembers
    if plan.as_cells:
        found = "following(leaf(z), z, inForce)" if remembers else "largest(leaf(z), z)"
        cells, walk = (
            LEAF + (FOLLOWING if remembers else LARGEST),
            f"  const symbol = {found};\n{SYMBOL}",
        )
    elif remembers:
        cells, walk = "", f"{WALK}  const symbol = TRANSITIONS[THRESHOLD[i]][inForce];\n{SYMBOL}"
    else:
        cells, walk = "", WALK + LABEL
    decision = NEXT + STEPS + walk if remembers else DECIDE + STEPS + walk + CONTROL
    if not plan.has_state:
        return cells + QUANTISE + decision + CONTROLLER + HELD
    controller = REMEMBERING.replace("TIME", "time" if plan.waits else "time = 0")
    return cells + QUANTISE + decision + SAME_FOR_ALL * (not remembers) + controller + HELD


TARGET = Target(export, features=True, remembers=True)
