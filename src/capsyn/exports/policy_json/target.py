"""Target ``json``: the policy as plain JSON that explains itself, with a JSON Schema."""

from __future__ import annotations

import json
import re
from importlib import resources
from typing import Any

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import SplitTree
from capsyn.exports.constants import cell_tables
from capsyn.exports.feature_texts import features_of
from capsyn.exports.golden import Golden
from capsyn.exports.identifiers import file_name
from capsyn.exports.plan import Plan
from capsyn.exports.target import Exported, NameOption, Target
from capsyn.version import __version__

FORMAT, VERSION = "capsyn-policy-json", 2
SCHEMA = "capsyn-policy.schema.json"
QUANTISER = (
    "All arithmetic is IEEE 754 double precision, rounded after each operation as written.",
    "A state is x = reading * scale + offset, for each component.",
    "If a component of x is NaN or infinite, the symbol is outside.safe and the status 2.",
    "If a component on an axis that is not periodic is below lower or above upper, the status is "
    "1, and, unless outside.rule is nearest, the symbol outside.safe. Otherwise the status is 0.",
    "On a periodic axis, if not lower <= x < upper: r = fmod(x - lower, upper - lower), where fmod "
    "is exact and has the sign of its first argument; if r < 0, then r = r + (upper - lower); "
    "r = lower + r; x = lower if r >= upper, else r.",
    "x = min(max(x, lower), upper).",
    "face(k) = lower + (upper - lower) * (k / steps). The lattice step z of the axis is the "
    "largest whole number 0 <= z < steps with z = 0 or face(z) <= x.",
)
RANKS = (
    "Then come features. Their program has values, numbered: the steps z, as doubles, then one for "
    "each instruction: a constant, or an operation on earlier values. Those under results are the "
    "values of the features. The rank of a feature is how many of its thresholds its value "
    "reaches (>=). Append the ranks to z: n, the number of states, is from here on that of states "
    "and features.",
)
GAP = (
    "If the symbol is outside.gap, where there is one, the symbol is outside.safe and the status "
    "1.",
)
WALK = (
    "Start at node 0. A node i with split[i] = -1 is a leaf; its symbol is threshold[i].",
    "Else the node compares v = z[split[i]] where split[i] is below the number n of states, and "
    "v = sum of planes[split[i] - n][j] * z[j] over the states j otherwise.",
    "Go on with node second[i] if v >= threshold[i], else with node i + 1.",
    *GAP,
)
CELLS_WALK = (
    "Start with size[j] = root_sizes[j] for each state j, and with entry i = 0; then for each j in "
    "order i = i * partitions[j] + floor(z[j] / size[j]).",
    "While entries[i] >= 0: let c = 0; for each j in order, but, where splits is not empty, only "
    "those whose bit 2^j is in splits[i]: size[j] = size[j] / refinement[j], then c = c * "
    "refinement[j] + floor(z[j] / size[j]) modulo refinement[j]; then i = entries[i] + c.",
    "The leaf is -1 - entries[i]. Up to default it is the symbol.",
    "Else let a be the leaf less default, less 1. Rows r = row_starts[a] .. row_starts[a + 1] - 1 "
    "have values row_constants[r] + sum of row_slopes[r * n + j] * z[j] over the n states j. The "
    "symbol is row_symbols[r] of the row with the largest value, of equals that of the first.",
    *GAP,
)

DWELL = (
    "A decision that is run in a loop keeps a control for min_dwell before it takes another: a "
    "symbol with another control than that in force is taken only where so much time has passed "
    "since the last change of the control, or where the status is in at_once.",
    "A symbol with the same control is taken, and changes nothing. The first symbol is taken.",
)


def export(plan: Plan, golden: Golden, options: NameOption) -> Exported:
    """Return the policy, ``NAME.json``, and the schema of all such files."""
    schema = resources.files("capsyn.exports.policy_json").joinpath("schema.json").read_bytes()
    text = json.dumps(document(plan), indent=2, allow_nan=False)
    # lists of numbers in one line each
    text = re.sub(
        r"\[\n\s+(-?\d[^\[\]{}\"]*?)\n\s+\]", lambda m: f"[{' '.join(m[1].split())}]", text
    )
    file = f"{file_name(options.name, plan.policy.name)}.json"
    return Exported({file: (text + "\n").encode(), SCHEMA: schema})


def document(plan: Plan) -> dict[str, Any]:
    """Return the policy as plain data."""
    policy, cells = plan.policy, plan.cells
    domain, alphabet = policy.domain, policy.alphabet
    states = zip(
        domain.names,
        domain.units,
        domain.lower.tolist(),
        domain.upper.tolist(),
        domain.periodic,
        plan.counts,
        plan.scale.tolist(),
        plan.offset.tolist(),
    )
    keys = ("name", "unit", "lower", "upper", "periodic", "steps", "scale", "offset")
    features = features_of(cells)
    return {
        "$schema": SCHEMA,
        "format": FORMAT,
        "version": VERSION,
        "generator": f"capsyn {__version__}",
        "header": list(plan.header),
        "name": policy.name,
        "sha256": plan.sha256,
        "states": [dict(zip(keys, state)) for state in states],
        "inputs": [
            {"name": name, "unit": unit} for name, unit in zip(alphabet.inputs, alphabet.units)
        ],
        "symbols": [
            {"name": name, "control": control}
            for name, control in zip(plan.symbol_names, policy.controls.tolist())
        ],
        "default": plan.default,
        "outside": {"rule": "nearest" if plan.nearest else "safe", "safe": plan.safe}
        | ({"gap": plan.gap} if plan.policy.gaps else {}),
        **({} if policy.time_unit == "s" else {"time_unit": policy.time_unit}),
        "min_dwell": plan.dwell,
        "at_once": list(plan.at_once),
        "horizon": policy.horizon,
        "settings": None if policy.settings is None else policy.settings.to_json(),
        "guarantee": plan.guarantee.to_json() | {"text": plan.guarantee.text},
        "quantiser": [*QUANTISER, *(RANKS if features else ())],
        "walk": list(CELLS_WALK if plan.as_cells else WALK),
        "dwell": list(DWELL),
        cells.kind: _tree(cells) if isinstance(cells, SplitTree) else _cells(cells),
    }


def _tree(tree: SplitTree) -> dict[str, Any]:
    features = features_of(tree)
    return {
        "nodes": tree.node_count,
        "depth": tree.depth,
        "split": tree.split.tolist(),
        "threshold": tree.threshold.tolist(),
        "second": tree.second.tolist(),
        "planes": tree.planes.tolist(),
        **({"features": features.to_json()} if features else {}),
    }


def _cells(cells: CellTree) -> dict[str, Any]:
    return {name.lower(): array.tolist() for name, array, _ in cell_tables(cells)}


TARGET = Target(export, features=True)
