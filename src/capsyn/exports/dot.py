"""Target ``dot``: the automaton of the policy, for Graphviz."""

from __future__ import annotations

from capsyn.automata.automaton import Automaton
from capsyn.errors import ProblemError
from capsyn.exports.golden import Golden
from capsyn.exports.identifiers import file_name
from capsyn.exports.made import Made
from capsyn.exports.plan import Plan


def files(plan: Plan, golden: Golden, *, name: str | None = None) -> Made:
    """Return the graph, ``NAME.dot``; see `Automaton.to_dot`.

    Parameters
    ----------
    name : str, optional
        What it is called, made an identifier. Default: the policy's name.
    """
    if len(plan.tree.cells.planes):
        raise ProblemError(
            "target dot draws the regions of symbols as boxes, and this policy has oblique splits "
            "or affine leaves"
        )
    header = "".join(f"// {line}\n" for line in plan.header)
    file = f"{file_name(name, plan.policy.name)}.dot"
    return Made({file: (header + Automaton.of(plan.policy).to_dot()).encode()})
