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

CODE = """
/** Return the lattice steps of a state of finite numbers; beyond the bounds the nearest. */
export function quantise(state) {
  return COUNTS.map((count, i) => latticeStep(state[i], LOWER[i], UPPER[i], PERIODIC[i], count));
}

/** Return [symbol, status] of a state: an index into CONTROLS, and OK, OUTSIDE or NOT_FINITE. */
export function decide(state) {
  if (state.length !== LOWER.length) throw new RangeError(`a state is ${LOWER.length} numbers`);
  const x = LOWER.map((_, i) => state[i] * SCALE[i] + OFFSET[i]);
  for (let i = 0; i < x.length; i++) {
    if (!Number.isFinite(state[i]) || !Number.isFinite(x[i])) return [SAFE, NOT_FINITE];
  }
  const inside = x.every((v, i) => PERIODIC[i] || (v >= LOWER[i] && v <= UPPER[i]));
  if (!inside && !NEAREST) return [SAFE, OUTSIDE];
  const z = quantise(x);
WALK}

/** Return the control vector of a state [input units]. */
export function control(state) {
  return CONTROLS[decide(state)[0]];
}

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

  /** Return the control vector that is held [input units]; the default before any step. */
  control() {
    return CONTROLS[this.symbol === null ? DEFAULT : this.symbol];
  }
}
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
  if (THRESHOLD[i] === GAP) return [SAFE, OUTSIDE];
  return [THRESHOLD[i], inside ? OK : OUTSIDE];
"""
"""Through the nodes of a tree."""
CELLS_WALK = """\
  const symbol = largest(leaf(z), z);
  if (symbol === GAP) return [SAFE, OUTSIDE];
  return [symbol, inside ? OK : OUTSIDE];
"""
CELLS = """
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
"""Functions that give the label of cells."""


def export(plan: Plan, golden: Golden, options: NameOption) -> Exported:
    """Return an ES module, ``NAME.mjs``."""
    lines = [*(f"// {line}" for line in plan.header), ""]
    for constant, value, note in constants(plan):
        lines += [f"// {note}"] * bool(note)
        lines.append(f"export const {constant} = {json.dumps(value)};")
    for constant, value, note in tables(plan):
        lines += [f"// {note}", f"const {constant} ="]
        lines += textwrap.wrap(f"{json.dumps(value)};", 100)
    lattice = resources.files("capsyn.exports.javascript").joinpath("lattice.js").read_text()
    code = CELLS + CODE.replace("WALK", CELLS_WALK) if plan.as_cells else CODE.replace("WALK", WALK)
    code = code.replace("[time unit]", f"[{plan.policy.time_unit}]")
    if features := features_of(plan.cells):
        code = javascript_ranks(features) + code.replace("quantise(x)", "withRanks(quantise(x))")
    text = "\n".join([*lines, "", lattice]) + code
    return Exported({f"{file_name(options.name, plan.policy.name)}.mjs": text.encode()})


TARGET = Target(export, features=True)
