"""Target ``json``: the policy as plain JSON that explains itself, with a JSON Schema."""

from __future__ import annotations

import json
import re
from importlib import resources
from typing import Any

from capsyn.exports.feature_texts import features_of
from capsyn.exports.golden import Golden
from capsyn.exports.identifiers import file_name
from capsyn.exports.plan import Plan
from capsyn.exports.target import Exported, NameOption, Target
from capsyn.policies.file import content_hash
from capsyn.version import __version__

FORMAT, VERSION, WITH_FEATURES = "capsyn-policy-json", 1, 3
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
WALK = (
    "Start at node 0. A node i with split[i] = -1 is a leaf; its symbol is threshold[i].",
    "Else the node compares v = z[split[i]] where split[i] is below the number n of states, and "
    "v = sum of planes[split[i] - n][j] * z[j] over the states j otherwise.",
    "Go on with node second[i] if v >= threshold[i], else with node i + 1.",
    "If the symbol is outside.gap, where there is one, the symbol is outside.safe and the status "
    "1.",
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
    policy, tree = plan.policy, plan.tree.cells
    domain, alphabet = policy.domain, policy.alphabet
    states = zip(
        domain.names,
        domain.units,
        domain.lower.tolist(),
        domain.upper.tolist(),
        domain.periodic,
        tree.counts,
        plan.scale.tolist(),
        plan.offset.tolist(),
    )
    keys = ("name", "unit", "lower", "upper", "periodic", "steps", "scale", "offset")
    features = features_of(tree)
    return {
        "$schema": SCHEMA,
        "format": FORMAT,
        "version": VERSION if features is None else WITH_FEATURES,
        "generator": f"capsyn {__version__}",
        "header": list(plan.header),
        "name": policy.name,
        "sha256": content_hash(policy),
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
        "min_dwell": plan.dwell,
        "horizon": policy.horizon,
        "settings": None if policy.settings is None else policy.settings.to_json(),
        "guarantee": plan.tree.guarantee.to_json() | {"text": plan.tree.guarantee.text},
        "quantiser": [*QUANTISER, *(RANKS if features else ())],
        "walk": list(WALK),
        "tree": {
            "nodes": tree.node_count,
            "depth": tree.depth,
            "split": tree.split.tolist(),
            "threshold": tree.threshold.tolist(),
            "second": tree.second.tolist(),
            "planes": tree.planes.tolist(),
        }
        | ({} if features is None else {"features": features.to_json()}),
    }


TARGET = Target(export, features=True)
