"""Programs as JavaScript source, made of known operations and number literals only."""

from __future__ import annotations

from capsyn.cells.feature_tree import FeatureTree
from capsyn.modelling.targets import target_program
from capsyn.policies.policy import Policy
from capsyn.programs.builder import loop_programs
from capsyn.programs.continuity import rate_kinks
from capsyn.programs.program import Program
from capsyn.programs.texts import JAVASCRIPT, javascript_lines


def program_javascript(program: Program, function: str) -> str:
    """Return a JavaScript function that runs a program on one state.

    The function takes an array per input, then one per output, which it fills. It calls the
    functions of `JAVASCRIPT` by their names, ``m_rint`` and so on.

    Raises
    ------
    ProblemError
        The program has an operation that is not in `OPERATIONS`.
    """
    names = [f"in{i}[{k}]" for i, (_, size) in enumerate(program.inputs) for k in range(size)]
    targets = [f"out{i}[{k}]" for i, (_, size) in enumerate(program.outputs) for k in range(size)]
    parameters = [f"in{i}" for i in range(len(program.inputs))]
    parameters += [f"out{i}" for i in range(len(program.outputs))]
    declared, results = javascript_lines(program, names)
    lines = [f"    {line}" for line in declared]
    lines += [f"    {target} = {result};" for target, result in zip(targets, results)]
    head = f"  function {function}({', '.join(parameters)}) {{"
    return "\n".join([head, *lines, "  }"]) + "\n"


def model_javascript(policy: Policy) -> str:
    """Return an ES module that exports ``model``, the programs that a closed loop runs.

    ``model`` is null where the policy has none, else it holds ``dynamics(x, u, xdot)``,
    ``runningCost(x, cost)``, ``terminalCost(x, cost, gradient)``, ``inside(x, inside)``, which
    tells whether a state is in the target, and ``kinks(x, u, sides)``, whose sides are constant
    where rates and cost are smooth. Exogenous inputs come after the states in x. Of a map ``xdot``
    is the state one sample later.
    """
    model = policy.model
    if model is None:
        return "export const model = null;\n"
    dynamics, cost = loop_programs(model.dynamics, model.running_cost, policy.discrete)
    programs = {
        "dynamics": dynamics,
        "runningCost": cost,
        "terminalCost": model.terminal_cost,
        "inside": target_program(policy.target, policy.space),
        "kinks": rate_kinks(dynamics, cost),
    }
    body = "".join(program_javascript(program, name) for name, program in programs.items())
    helpers = _helpers(body)
    names = ", ".join(programs)
    return f"export const model = (() => {{\n{helpers}{body}  return {{ {names} }};\n}})();\n"


def features_javascript(policy: Policy) -> str:
    """Return an ES module that exports ``features(z, values)``, of lattice steps; "" if none."""
    if not isinstance(policy.cells, FeatureTree):
        return ""
    body = program_javascript(policy.cells.features.program, "features")
    return f"export const features = (() => {{\n{_helpers(body)}{body}  return features;\n}})();\n"


def _helpers(body: str) -> str:
    """Return the functions of `JAVASCRIPT` that a text calls."""
    used = ((name, text) for name, text in JAVASCRIPT.items() if f"m_{name}(" in body)
    return "".join(f"  const m_{name} = {text};\n" for name, text in used)
