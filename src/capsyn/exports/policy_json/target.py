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

FORMAT = "capsyn-policy-json"
SCHEMA, SCHEMA_3 = "capsyn-policy.schema.json", "capsyn-policy-3.schema.json"
"""Of version 2, and of 3, which has more to remember than one least time."""
SCHEMA_4, SCHEMA_5 = "capsyn-policy-4.schema.json", "capsyn-policy-5.schema.json"
"""The same with exogenous inputs."""
SCHEMAS = {2: SCHEMA, 3: SCHEMA_3, 4: SCHEMA_4, 5: SCHEMA_5}
TOLD = (
    "A reading has a component for each of states, in order, then one for each of exogenous. "
    "Below, a state is one of either, and n is the number of both.",
)
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

ROW = (
    "Let s be the symbol in force: default before the first decision. Up to the last row of "
    "transitions the leaf is the number of a row, and the next symbol is transitions[leaf][s]."
)
TREE_ROW = "Start at node 0. A node i with split[i] = -1 is a leaf; its number is threshold[i]."
CELLS_ROWS = (
    f"The leaf is -1 - entries[i]. {ROW}",
    "Else let a be the leaf less the number of rows of transitions. Rows r = row_starts[a] .. "
    "row_starts[a + 1] - 1 have values row_constants[r] + sum of row_slopes[r * n + j] * z[j] over "
    "the n states j - row_prices[a] * row_ratios[s * (default + 1) + row_symbols[r]]; those where "
    "that ratio is negative are left out. The next symbol is row_symbols[r] of the row with the "
    "largest value, of equals s if it is among them, else that of the first; it is s if all are "
    "left out.",
)
HOLDS = (
    "A decision that is run in a loop keeps the symbol in force from one to the next. The first "
    "symbol is taken, and all times begin with it.",
    "Until hold_off is over, outside.safe is wanted, whatever the decision.",
    "A symbol whose number in kinds is that of the symbol in force is taken, and is no switch.",
    "Another symbol is taken, too, where the status is in at_once.",
    "Otherwise, while the time since the symbol in force was entered is less than its time in "
    "holds, it stays.",
    "Otherwise each input i keeps its value while the time since it changed is less than "
    "input_holds[i], and the other inputs take their values of the symbol that is wanted. If that "
    "is its control, it is taken. If not, and that is the control of the symbol in force, the "
    "symbol in force stays. Otherwise the first symbol below default is taken that has that "
    "control, and to which no transition from the symbol in force is in forbidden; if there is "
    "none, the symbol in force stays.",
    "With each switch the time of the symbol begins anew, and that of each input whose value "
    "changes.",
)
DWELL = (
    "A decision that is run in a loop keeps a control for min_dwell before it takes another: a "
    "symbol with another control than that in force is taken only where so much time has passed "
    "since the last change of the control, or where the status is in at_once.",
    "A symbol with the same control is taken, and changes nothing. The first symbol is taken.",
)


def export(plan: Plan, golden: Golden, options: NameOption) -> Exported:
    """Return the policy, ``NAME.json``, and the schema of all such files."""
    data = document(plan)
    text = json.dumps(data, indent=2, allow_nan=False)
    # lists of numbers in one line each
    text = re.sub(
        r"\[\n\s+(-?\d[^\[\]{}\"]*?)\n\s+\]", lambda m: f"[{' '.join(m[1].split())}]", text
    )
    file = f"{file_name(options.name, plan.policy.name)}.json"
    return Exported({file: (text + "\n").encode(), data["$schema"]: _schema(data["version"])})


def _schema(version: int) -> bytes:
    """Return the schema of a version of the format."""
    folder = resources.files("capsyn.exports.policy_json")
    schema = folder.joinpath("schema.json").read_bytes()
    if version == 2:
        return schema
    whole, required = json.loads(schema), {"dwell"}
    if version % 2:  # remembers
        more = json.loads(folder.joinpath("memory.json").read_bytes())
        arrays = whole["properties"]["cells"]["properties"]
        arrays |= {"row_prices": arrays["row_starts"], "row_ratios": arrays["row_constants"]}
        del whole["properties"]["min_dwell"]
        whole["properties"] |= more
        required |= {*more} - {"transitions", "price"}
    if version >= 4:
        told = whole["properties"]["states"] | {"description": "What comes after the states."}
        whole["properties"] |= {"exogenous": told, "version": _version(version)}
        required |= {"exogenous"}
    required |= {*whole["required"]} & {*whole["properties"]}
    whole["required"] = [name for name in whole["properties"] if name in required]
    return (json.dumps(whole, indent=2) + "\n").encode()


def _version(version: int) -> dict[str, Any]:
    about = f"{version}: as {version - 2}, with exogenous inputs, which come after the states."
    return {"description": about, "const": version}


def document(plan: Plan) -> dict[str, Any]:
    """Return the policy as plain data."""
    policy, cells = plan.policy, plan.cells
    domain, alphabet = policy.space, policy.alphabet
    axes = zip(
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
    readings, n = [dict(zip(keys, axis)) for axis in axes], policy.domain.n
    told, features = policy.exogenous is not None, features_of(cells)
    version = 2 + plan.has_state + 2 * told
    return {
        "$schema": SCHEMAS[version],
        "format": FORMAT,
        "version": version,
        "generator": f"capsyn {__version__}",
        "header": list(plan.header),
        "name": policy.name,
        "sha256": plan.sha256,
        "states": readings[:n],
        **({"exogenous": readings[n:]} if told else {}),
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
        **(_memory(plan) if plan.has_state else {"min_dwell": plan.dwell}),
        "at_once": list(plan.at_once),
        "horizon": policy.horizon,
        **({"discrete": True} if policy.discrete else {}),
        "settings": None if policy.settings is None else policy.settings.to_json(),
        "guarantee": plan.guarantee.to_json() | {"text": plan.guarantee.text},
        "quantiser": [*(TOLD if told else ()), *QUANTISER, *(RANKS if features else ())],
        "walk": list(_walk(plan)),
        "dwell": list(HOLDS if plan.has_state else DWELL),
        cells.kind: _tree(cells) if isinstance(cells, SplitTree) else _cells(cells),
    }


def _walk(plan: Plan) -> tuple[str, ...]:
    """Return from lattice steps to the next symbol, in words."""
    if not plan.policy.remembers:
        return CELLS_WALK if plan.as_cells else WALK
    if plan.as_cells:
        return (*CELLS_WALK[:2], *CELLS_ROWS, *GAP)
    return (TREE_ROW, *WALK[1:3], ROW, *GAP)


def _memory(plan: Plan) -> dict[str, Any]:
    """Return what depends on the symbol in force, and what its changes wait for."""
    rules, switching = plan.policy.rules, plan.policy.switching
    return {
        **({"transitions": plan.transitions.tolist()} if plan.policy.remembers else {}),
        **({} if switching is None else {"price": switching.to_json()["price"]}),
        "delay": plan.policy.delay,
        "holds": rules.holds.tolist(),
        "input_holds": rules.input_holds.tolist(),
        "kinds": rules.kinds.tolist(),
        "forbidden": plan.forbidden,
        "hold_off": plan.hold_off,
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


TARGET = Target(export, features=True, remembers=True)
