"""Target ``dot``: the automaton of the policy, for Graphviz.

Of a policy that remembers, an edge is a switch that is made somewhere; what changes wait for stands
in the lines at the top.
"""

from __future__ import annotations

from capsyn.automata.automaton import Automaton
from capsyn.errors import ProblemError
from capsyn.exports.golden import Golden
from capsyn.exports.identifiers import file_name
from capsyn.exports.plan import Plan
from capsyn.exports.target import Exported, NameOption, Target


def export(plan: Plan, golden: Golden, options: NameOption) -> Exported:
    """Return the graph, ``NAME.dot``; see `Automaton.to_dot`."""
    if plan.policy.has_planes:
        raise ProblemError(
            "target dot draws the regions of symbols as boxes, and this policy has oblique splits "
            "or affine leaves"
        )
    header = "".join(f"// {line}\n" for line in plan.header)
    file = f"{file_name(options.name, plan.policy.name)}.dot"
    return Exported({file: (header + Automaton.of(plan.policy).to_dot()).encode()})


TARGET = Target(export, planes=False, cells=False, remembers=True)
