"""What a policy is, in figures, and hints where a figure smells."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.feature_tree import FeatureTree
from capsyn.cells.masks import several
from capsyn.cells.packing import lookup_arrays, packed_bytes
from capsyn.cells.split_tree import SplitTree
from capsyn.modelling.settings import SsacSettings
from capsyn.modelling.targets import describe_target
from capsyn.policies.file import content_hash
from capsyn.policies.guarantee import CONFIDENCE, Guarantee
from capsyn.policies.in_force import reachable, staying_rows, stays
from capsyn.policies.policy import DecisionTree, Policy, cell_tree

SAMPLES = 10_000
"""Random states at which the share where symbols stay is estimated where planes bound them."""
PER_AXIS = ("partitions", "refinement")
"""What the structure of cells has one number of for each axis."""


def report(policy: Policy) -> dict[str, Any]:
    """Return the figures of a policy, or of a decision tree, as plain data.

    A time unit of s is left out, as is what is there for exogenous inputs and default laws only.
    """
    alphabet, names = policy.alphabet, [*policy.alphabet.names, "default"]
    shares, digest = policy.volume_shares.tolist(), content_hash(policy)
    readings, n = _axes(policy), policy.domain.n
    law = policy.model is not None and policy.model.prediction is not None
    return {
        "name": policy.name,
        "states": readings[:n],
        **({} if policy.exogenous is None else {"exogenous": readings[n:]}),
        "symbols": [
            {"name": names[k], "value": alphabet.values[k].tolist(), "volume_share": shares[k]}
            for k in range(len(alphabet))
        ],
        "inputs": list(alphabet.inputs),
        "target": None if policy.target is None else describe_target(policy.target, policy.space),
        "default": {"value": policy.default.tolist(), "volume_share": shares[-1]}
        | ({"law": True} if law else {}),
        "gaps": policy.gaps,
        "unused_symbols": unused_symbols(policy),
        **(_tree(policy) if isinstance(policy, DecisionTree) else _cells(policy)),
        "outside": policy.outside
        if isinstance(policy.outside, str)
        else policy.symbol_name(policy.outside),
        **({"outside_at_once": True} if policy.outside_at_once else {}),
        **({} if policy.time_unit == "s" else {"time_unit": policy.time_unit}),
        "min_dwell": policy.min_dwell,
        **_memory(policy),
        **({} if policy.kept is None else {"limits": _limits(policy)}),
        **({"source": _source(policy)} if "source" in policy.statistics else {}),
        "horizon": policy.horizon,
        **({"discrete": True} if policy.discrete else {}),
        "settings": None if policy.settings is None else policy.settings.to_json(),
        "statistics": policy.statistics,
        "evidence": policy.evidence if policy.evidence.get("sha256") == digest else {},
        "sha256": digest,
        "hints": hints(policy),
    }


def _source(policy: Policy) -> str:
    """Return what a policy was made from, if not by sSAC, in words."""
    source = policy.statistics["source"]
    made = source.get("finite_control_set")
    if not isinstance(made, dict):
        return f"the function {source.get('function', '?')}"
    blocks = ", ".join(map(str, made.get("blocks", [])))
    return (
        f"predictive control with a finite control set, moves of {blocks} sample(s) of "
        f"{made.get('sample_time')} {policy.time_unit}"
    )


def _axes(policy: Policy) -> list[dict[str, Any]]:
    """Return what is said of each state, and of each exogenous input after them."""
    cells, space = policy.cells, policy.space
    structure = cells.structure()
    return [
        {
            "name": space.names[i],
            "unit": space.units[i],
            "lower": space.lower[i],
            "upper": space.upper[i],
            "periodic": space.periodic[i],
            "steps": cells.counts[i],
            **{key: structure[key][i] for key in PER_AXIS if key in structure},
        }
        for i in range(space.n)
    ]


def unused_symbols(policy: Policy) -> list[str]:
    """Return the names of symbols that are never in force."""
    names = policy.alphabet.names
    if policy.remembers:
        known = set(reachable(policy).tolist())
        return [name for k, name in enumerate(names) if k not in known]
    return [name for name, share in zip(names, policy.volume_shares) if not share]


def _memory(policy: Policy) -> dict[str, Any]:
    """Return what a policy does about switches: its rows, its `Switching` and its delay, if any."""
    data: dict[str, Any] = {}
    if policy.remembers:
        table = policy.transitions
        used = table[np.unique(policy.cells.constant_leaves(len(table)))]
        data["memory"] = {
            "rows": len(used),
            "varying_rows": int((used != used[:, :1]).any(axis=1).sum()),
            "staying_share": _staying_share(policy),
        }
    if policy.switching is not None:
        data["switching"] = policy.switching.to_json()
    return data | ({"delay": policy.delay} if policy.delay else {})


def _limits(policy: Policy) -> dict[str, Any]:
    """Return from where limits are kept, in figures."""
    assert policy.kept is not None
    cells, rows = policy.kept.cells, policy.kept.rows
    places, volumes = cells.volumes()
    kept = np.all(rows[:, : max(rows.shape[1] - 1, 1)], axis=1)
    always = np.asarray(kept)[cells.labels_at(places)]
    return {
        "kept_share": float(volumes[always].sum() / volumes.sum()),
        "sample_time": policy.kept.sample_time,
        "parameters": {name: list(ends) for name, ends in policy.kept.parameters.items()},
        "steps": list(cells.counts),
    }


def _staying_share(policy: Policy) -> float:
    """Return the share of the volume where a symbol stays only because it is in force.

    Where planes bound symbols it is estimated at `SAMPLES` random states.
    """
    if policy.has_planes:
        return float(stays(policy, policy.space.sample(SAMPLES)).mean())
    boxes = policy.cells.boxes()
    volumes = boxes.volumes()
    return float(volumes[staying_rows(policy)[boxes.labels]].sum() / volumes.sum())


def _holds_back(settings: SsacSettings | None) -> str:
    """Return which settings keep the steepest symbol from being chosen."""
    if settings is None:
        return "control_weight or gamma hold it back"
    if settings.rule == "steepest":
        return "control_weight holds it back"
    wanted = "gamma" if settings.alpha_d is None else "alpha_d"
    return f"{wanted} holds it back" + (", or control_weight" if settings.control_weight else "")


def _cells(policy: Policy) -> dict[str, Any]:
    cells = cell_tree(policy)
    return {
        "max_level": cells.max_level
        if cells.affine is None
        else max(int(cells.times(some).max()) for some in cells.levels()),
        "adaptive": cells.splits is not None,
        "cells": cells.leaf_count,
        "affine_leaves": 0 if cells.affine is None else len(cells.affine),
        "table_bytes": _bytes(cells),
        "packed_bytes": packed_bytes(cells),
        "mixed_cells": len(cells.mixed_cells),
        "mixed_share": policy.mixed_share,
    }


def _tree(tree: DecisionTree) -> dict[str, Any]:
    return {
        "nodes": tree.node_count,
        "depth": tree.depth,
        "planes": len(tree.cells.planes),
        "features": feature_figures(tree.cells),
        "packed_bytes": packed_bytes(tree.cells),
        "tree_bytes": _bytes(tree.cells),
        "guarantee": _guarantee(tree.guarantee),
    }


def feature_figures(tree: SplitTree) -> dict[str, Any] | None:
    """Return the features of a tree, and what they take; None where it has none."""
    if not isinstance(tree, FeatureTree):
        return None
    features = tree.features
    return {
        "names": list(features.names),
        "operations": sum(name != "const" for name, *_ in features.program.instructions),
        "thresholds": [len(t) for t in features.thresholds],
        "margin": features.margin,
    }


def _bytes(cells: CellTree | SplitTree) -> int:
    return sum(array.nbytes for array in lookup_arrays(cells))


def _guarantee(guarantee: Guarantee) -> dict[str, Any]:
    interval = {"low": guarantee.low, "high": guarantee.high, "confidence": CONFIDENCE}
    return (
        guarantee.to_json()
        | (interval if guarantee.states else {})
        | {"reached": guarantee.reached, "text": guarantee.text}
        | ({} if guarantee.loop is None else {"loop_text": guarantee.loop.text})
    )


def hints(policy: Policy) -> list[str]:
    """Return one sentence for each figure that suggests a mistake or a better choice."""
    sample = policy.statistics.get("sample")
    sentences = [*_cell_hints(policy), *_solve_hints(policy)]
    if sample:
        sentences += [*_descent_hints(policy, sample), *_scale_hints(sample)]
    return sentences


def _cell_hints(policy: Policy) -> Iterator[str]:
    """Yield what the cells show; a table, which is as it is, has no such hints."""
    yield from _unused_hints(policy)
    if "table" in policy.statistics:
        return
    mixed = _mixed_share(policy)
    if mixed > 0.1 and not policy.has_planes:
        affine = ", or take affine leaves" if policy.space.n > 2 else ""
        yield (
            f"cells whose test points disagree cover {mixed:.0%} of the volume: "
            f"the boundaries are coarse; raise max_level{affine}"
        )


def _unused_hints(policy: Policy) -> Iterator[str]:
    """Yield which symbols are never in force, and which a tree has lost."""
    unused, had = unused_symbols(policy), getattr(policy, "guarantee", None)
    if had is not None and had.lost:
        yield had.lost_text
        unused = [name for name in unused if name not in had.lost]
    if not unused or "table" in policy.statistics:
        return
    if had is not None and (had.mode != "exact" or had.level is not None):
        yield (
            f"never used in the tree: {', '.join(unused)}; see whether the policy that it was made "
            "from uses them"
        )
        return
    steepest = policy.settings is not None and policy.settings.rule == "steepest"
    weights = "control_weight" if steepest else "gamma and control_weight"
    stays = [policy.volume_shares[policy.alphabet.names.index(name)] > 0 for name in unused]
    done = "entered" if any(stays) else "used"
    look = f", or look at {weights}" if policy.horizon is not None else ""  # of sSAC
    yield f"never {done}: {', '.join(unused)}; drop them{look}"


def _mixed_share(policy: Policy) -> float:
    """Return the share of the volume of cells whose test points did not agree.

    Of a policy that remembers it is the mean over the symbols in force, each of which has its own
    boundaries.
    """
    cells = policy.cells
    if not policy.remembers or not isinstance(cells, CellTree):
        return policy.mixed_share
    places, volumes = cells.volumes()
    order = np.argsort(places)
    own = volumes[order[np.searchsorted(places, cells.mixed_cells, sorter=order)]]
    unlike = several(cells.mixed_labels).mean(axis=1)
    return float(own @ unlike / np.prod(cells.counts, dtype=float))


def _solve_hints(policy: Policy) -> Iterator[str]:
    count, solves = (policy.statistics.get(k, 0) for k in ("not_finite_points", "solves"))
    if count:
        yield (
            f"{count} of {solves} solves gave no finite result and take the default control, for "
            f"instance at {policy.statistics.get('not_finite_example')}: check the model there"
        )


def _descent_hints(policy: Policy, sample: dict[str, Any]) -> Iterator[str]:
    """Yield what keeps the cost from falling at random states."""
    settings = policy.settings
    exact = policy.discrete and settings is not None and settings.sensitivity != "first order"
    order = "" if exact else " to first order"
    by_gamma = settings and settings.rule == "schedule" and settings.alpha_d is None
    if by_gamma and sample["negative_cost"] > 0:
        yield (
            f"the cost is negative in {sample['negative_cost']:.0%} of the volume, where gamma "
            "asks to raise it: add a constant to the cost, or use rule steepest"
        )
    if sample["held_back"] > 0.05:
        yield (
            f"in {sample['held_back']:.0%} of the volume the chosen symbol does not lower the "
            f"cost{order} though another would: {_holds_back(settings)}"
        )
    if sample["no_descent"] - sample["held_back"] > 0.05:
        yield (
            f"in {sample['no_descent'] - sample['held_back']:.0%} of the volume no symbol lowers "
            f"the cost{order}: the alphabet may be too weak there, or the horizon too short"
        )
    if sample["indifferent"] > 0.05:
        yield (
            f"in {sample['indifferent']:.0%} of the volume several symbols tie: the cost may not "
            "see what the inputs do within the horizon"
        )
    if sample["reach"] is not None and sample["reach"] < 0.01:
        yield (
            f"the best symbol, acting all along the horizon, takes off {sample['reach']:.2%} of "
            "the cost (median, first order): the horizon may be too short, or far too long, or the "
            "alphabet too weak"
        )


def _scale_hints(sample: dict[str, Any]) -> Iterator[str]:
    """Yield which weights are out of scale with the rest of the score."""
    wanted, effort = sample["wanted_over_reachable"], sample["effort_over_choice"]
    if wanted is not None and wanted > 1000:
        yield (
            f"the wanted sensitivity is {wanted:.3g} times what the symbols reach (median): gamma "
            "or alpha_d is not scaled to the cost, and control_weight has no effect"
        )
    if wanted is not None and wanted < 0.1:
        yield (
            f"the wanted sensitivity is {wanted:.2g} of what the symbols reach (median): gamma or "
            "alpha_d is not scaled to the cost, and the weakest symbols win"
        )
    if effort is not None and effort > 1:
        yield (
            f"the control efforts differ {effort:.3g} times more than the rest of the scores "
            "(median): control_weight decides, not the goal"
        )
