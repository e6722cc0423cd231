"""Programs as JavaScript source, made of known operations and number literals only."""

from __future__ import annotations

import json
import re

from capsyn.errors import ProblemError
from capsyn.modelling.targets import target_program
from capsyn.policies.policy import Policy
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Program

HELPERS = {
    "fabs": "Math.abs",
    "rint": """x => {
    const nearest = Math.round(x);
    return Math.abs(x % 1) === 0.5 && nearest % 2 !== 0 ? nearest - 1 : nearest;
  }""",
    "copysign": "(x, y) => (y < 0 || Object.is(y, -0) ? -Math.abs(x) : Math.abs(x))",
    "fmod": "(x, y) => x % y",
    "pow": "(x, y) => (x === 1 || (x === -1 && Math.abs(y) === Infinity) ? 1 : Math.pow(x, y))",
    "erf": """x => {
    const square = x * x;
    if (Math.abs(x) > 6) return Math.sign(x);
    if (Math.abs(x) < 2.5) { // Abramowitz and Stegun, 7.1.6
      let term = x, sum = x;
      for (let k = 1; Math.abs(term) > 1e-17 * Math.abs(sum); k++) {
        term *= (2 * square) / (2 * k + 1);
        sum += term;
      }
      return (2 / Math.sqrt(Math.PI)) * Math.exp(-square) * sum;
    }
    let tail = 0; // the continued fraction of erfc, 7.1.14
    for (let k = 60; k > 0; k--) tail = k / 2 / (Math.abs(x) + tail);
    const rest = Math.exp(-square) / Math.sqrt(Math.PI) / (Math.abs(x) + tail);
    return Math.sign(x) * (1 - rest);
  }""",
}
"""Functions of the C library that are not called so in JavaScript's ``Math``."""


def program_javascript(program: Program, function: str) -> str:
    """Return a JavaScript function that runs a program on one state.

    The function takes an array per input, then one per output, which it fills. It calls `HELPERS`
    by their names, ``m_rint`` and so on.

    Raises
    ------
    ProblemError
        The program has an operation that is not in `OPERATIONS`.
    """
    names = [f"in{i}[{k}]" for i, (_, size) in enumerate(program.inputs) for k in range(size)]
    targets = [f"out{i}[{k}]" for i, (_, size) in enumerate(program.outputs) for k in range(size)]
    parameters = [f"in{i}" for i in range(len(program.inputs))]
    parameters += [f"out{i}" for i in range(len(program.outputs))]
    lines = []
    for operation, *operands in program.instructions:
        value = f"v{len(names)}"
        lines.append(f"    const {value} = {_expression(operation, operands, names)};")
        names.append(value)
    lines += [f"    {target} = {names[k]};" for target, k in zip(targets, program.results)]
    head = f"  function {function}({', '.join(parameters)}) {{"
    return "\n".join([head, *lines, "  }"]) + "\n"


def _expression(operation: str, operands: list[float], names: list[str]) -> str:
    """Return an operation's C expression as JavaScript: they differ in names only."""
    if operation == "const":
        return json.dumps(float(operands[0]))  # NaN and Infinity as JavaScript has them
    if operation not in OPERATIONS:
        raise ProblemError(f"a program must be of known operations; got {operation!r}")
    text = OPERATIONS[operation].c.replace("ONE", "1").replace("ZERO", "0")
    text = re.sub(r"\bm_(\w+)", lambda f: f[0] if f[1] in HELPERS else f"Math.{f[1]}", text)
    return text.format(*(names[int(k)] for k in operands))


def model_javascript(policy: Policy) -> str:
    """Return an ES module that exports ``model``, the programs that a closed loop runs.

    ``model`` is null where the policy has none, else it holds ``dynamics(x, u, xdot)``,
    ``runningCost(x, cost)``, ``terminalCost(x, cost, gradient)`` and ``inside(x, inside)``, which
    tells whether a state is in the target.
    """
    if policy.model is None:
        return "export const model = null;\n"
    programs = {
        "dynamics": policy.model.dynamics,
        "runningCost": policy.model.running_cost,
        "terminalCost": policy.model.terminal_cost,
        "inside": target_program(policy.target, policy.domain),
    }
    body = "".join(program_javascript(program, name) for name, program in programs.items())
    helpers = "".join(
        f"  const m_{name} = {text};\n" for name, text in HELPERS.items() if f"m_{name}(" in body
    )
    names = ", ".join(programs)
    return f"export const model = (() => {{\n{helpers}{body}  return {{ {names} }};\n}})();\n"
