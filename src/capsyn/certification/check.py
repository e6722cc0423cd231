"""Go through a proof of arrival, set by set, with arithmetic of its own.

Nothing here or in `checker` is of `capsyn.reach`, which makes the proofs, or of the bounds that it
uses. Of a file see `capsyn.certification.proof_file`.
"""

from __future__ import annotations

import json
import os
import time
import zipfile
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.certification.checker.cells import (
    Cells,
    Claims,
    check_twins,
    need,
    points_of,
    spread,
    truth,
)
from capsyn.certification.checker.flows import Flows
from capsyn.certification.checker.pieces import Pieces
from capsyn.certification.checker.sets import Tree, corners
from capsyn.compression.trees import exact_tree
from capsyn.errors import CapsynError, CertificateError
from capsyn.policies.file import content_hash
from capsyn.policies.policy import DecisionTree, Policy
from capsyn.programs.program import Program

FORMAT, MOST_BYTES, VERTICES = 1, 1 << 34, 12
NARROW = 4e-9
"""Share of its range by which the cell of an exogenous input of one value may be beyond it."""
CLOSED = 1e-9
"""Share of a cell by which a start may be wider, to have the face where starts end."""
ARRAYS = {"header", "lower", "upper", "counts", "bound", "twins", "starts", "pieces", "flows"}
MALFORMED = (
    CapsynError, OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError,
    MemoryError, EOFError, NotImplementedError, RecursionError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What reading bytes that anyone may have written can raise; each is told as a refusal."""


@dataclass(frozen=True)
class Checked:
    """What was gone through."""

    cells: int  # that are proved, in one layer at least
    seconds: float
    plant: str  # "its own", the policy's model, or "given"


def check(path: str | os.PathLike[str], policy: Policy) -> Checked:
    """Return what a file of `Certificate.save` proves of a policy, having gone through all of it.

    Raises
    ------
    CertificateError
        It is no such file, or of another policy, or something in it does not hold.
    """
    began = time.monotonic()
    try:
        arrays = _read(path)
        head = json.loads(arrays["header"].tobytes())
        claims = claims_of(head, policy)
        with np.errstate(all="ignore"):
            proved = check_proof(claims, arrays)
    except MALFORMED as error:
        if isinstance(error, CertificateError):
            raise
        text = " ".join(str(error).split())[:200]
        raise CertificateError(f"the certificate cannot be read: {text}") from None
    own = policy.model is not None and head["rates"] == json.loads(
        json.dumps(policy.model.dynamics.to_json())
    )
    return Checked(proved, time.monotonic() - began, "its own" if own else "given")


def _read(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    with zipfile.ZipFile(path) as file:
        sizes = {info.filename: info.file_size for info in file.infolist()}
    need(
        [set(sizes) == {f"{k}.npy" for k in ARRAYS}], "the certificate lacks arrays, or has others"
    )
    need([sum(sizes.values()) <= MOST_BYTES], "the certificate is too large")
    with np.load(path, allow_pickle=False) as loaded:
        return {name: loaded[name] for name in ARRAYS}


def claims_of(head: dict[str, Any], policy: Policy) -> Claims:
    """Return the loop that a header is about.

    Raises
    ------
    CertificateError
        It does not fit the policy, or is of a kind that is not known.
    """
    need([head["format"] == FORMAT], f"the certificate is of format {head['format']}"[:80])
    need([head["policy"] == content_hash(policy)], "the certificate is of another policy")
    space, rules, n = policy.space, policy.rules, policy.space.n
    tree = policy if isinstance(policy, DecisionTree) else exact_tree(policy)
    rates, target, avoid = (Program.from_json(head[k]) for k in ("rates", "target", "avoid"))
    controls, parameters, noise = (
        np.array(head[k], dtype=float) for k in ("controls", "parameters", "noise")
    )
    holds, (period, delay) = np.array(head["holds"]), (head["period"], head["delay"])
    need([parameters.ndim == 2 and len(parameters) == 2], "parameters are no ranges")
    ports = (("x", n), ("u", controls.shape[-1]), ("p", parameters.shape[1]))
    nearest = policy.outside == "nearest" and not tree.has_planes
    now, rows = np.arange(len(controls)), tree.transitions
    follow = np.where(rules.forbidden[now, rows], now, rows)
    if policy.gaps:
        follow[follow == now[-1]] = -1
    held = bool((holds > 1).any())
    same = rules.kinds[:, None] == rules.kinds
    same &= (holds[:, None] != holds) | (follow[:, :, None] != follow[:, None]).any(axis=0)
    for holds_true, what in (
        (head["space"] == json.loads(json.dumps(space.to_json())), "the states are others"),
        (head["states"] == policy.domain.n, "the states are others"),
        (np.array_equal(controls, policy.controls), "the controls are others"),
        (head["kinds"] == rules.kinds.tolist(), "the kinds of controls are others"),
        (head["nearest"] is nearest, "the rule outside is another"),
        (rates.inputs == ports[: 3 if parameters.size else 2], "the rates have other inputs"),
        (len(rates.results) == n, "the rates are not those of the states"),
        (target.inputs == avoid.inputs == ports[:1], "sets are not of the states"),
        (len(target.results) == len(avoid.results) == 1, "sets are no conditions"),
        (np.isfinite(parameters).all() and (parameters[0] <= parameters[1]).all(), "no ranges"),
        (noise.shape == (n,) and np.isfinite(noise).all() and noise.min() >= 0, "noise is none"),
        (type(period) is type(delay) is float, "times are no numbers"),
        (0 <= delay <= period < np.inf and period > 0, "the delay must be at most a sample"),
        (
            holds.shape == now.shape and holds.dtype == np.int64 and holds.min() >= 0,
            "holds are none",
        ),
        (not rules.input_holds.any(), "inputs that are held one by one are not known"),
        (not (held and nearest and policy.outside_at_once), "labels at once outside are not known"),
    ):
        need([holds_true], f"the certificate does not fit the policy: {what}")
    own = Tree.of(tree.cells, space)
    if tree is not policy and not policy.cells.has_planes:
        _check_tree(own, tree.transitions, policy)
    layered = held or delay > 0 or bool((follow != follow[:, :1]).any())
    flow = Flows(rates, n, parameters, space.widths)
    return Claims(
        space, policy.domain.n, own, follow, rules.kinds, holds, layered, flow, target, avoid,
        controls, noise, period, delay, nearest, same,
    )  # fmt: skip


def _check_tree(tree: Tree, rows: np.ndarray, policy: Policy) -> None:
    """Go through the cells of a policy: the tree has the row of each there."""
    boxes = policy.cells.boxes()
    step = policy.space.widths / np.array(policy.cells.counts)
    low, high = (policy.space.lower + step * x for x in (boxes.lower + 0.25, boxes.upper - 0.25))
    box, leaf, moved = tree.under(low, high)
    same = (rows[tree.row[leaf]] == policy.transitions[boxes.labels[box]]).all(axis=1)
    box, leaf, moved = (x[~same] for x in (box, leaf, moved))
    need(~tree.met(low[box], high[box], leaf, moved), "the tree is not that of cell {}", box)


def _records(arrays: dict[str, np.ndarray], n: int) -> tuple[np.ndarray, ...]:
    f, i, q = np.float64, np.int32, np.int64
    shape = [("v", f, 2 * (VERTICES if n == 2 else n)), ("error", f, n), ("count", i)]
    numbers = ("held samples ended id merged", "label samples start end waits")
    pieces, flows = (np.dtype(shape + [(k, i) for k in x.split()], align=True) for x in numbers)
    starts = np.dtype([("lower", f, n), ("upper", f, n), ("held", i), ("cell", q), ("wave", i),
                       ("bound", f), ("piece", q), ("flow", q)])  # fmt: skip
    for name, kind in (("pieces", pieces), ("flows", flows), ("starts", starts)):
        records = arrays[name]
        need([records.dtype == kind and records.ndim == 1], f"{name} are no records")
    return arrays["pieces"], arrays["flows"], arrays["starts"]


def check_proof(claims: Claims, arrays: dict[str, np.ndarray]) -> int:
    """Return how many cells are proved by arrays of a file.

    Raises
    ------
    CertificateError
        Something does not hold.
    """
    n, labels = claims.space.n, len(claims.controls)
    pieces, flows, starts = _records(arrays, n)
    layers, bound, twins = labels if claims.layered else 1, arrays["bound"], arrays["twins"]
    lower, upper, counts = (arrays[k] for k in ("lower", "upper", "counts"))
    margin = NARROW * claims.space.widths * (np.arange(n) >= claims.moving)
    total = int(np.prod(counts.astype(float)))
    for holds, what in (
        (lower.shape == upper.shape == counts.shape == (n,), "the grid is none"),
        (lower.dtype == upper.dtype == bound.dtype == np.float64, "the grid is none"),
        (
            counts.dtype == np.int64 and (counts > 0).all() and (lower < upper).all(),
            "the grid is none",
        ),
        ((lower >= claims.space.lower - margin).all(), "the grid is beyond the states"),
        ((upper <= claims.space.upper + margin).all(), "the grid is beyond the states"),
        (bound.shape == twins.shape == (layers, total), "bounds are not of the cells"),
        (bool((bound >= 0).all()), "bounds are no times"),
        (
            twins.dtype == np.int32 and ((twins >= 0) & (twins < layers)).all(),
            "twins are no layers",
        ),
    ):
        need([holds], what)
    owner = _owners(claims, starts, pieces, flows, total)
    cells = Cells(lower, upper, counts, bound, np.full(bound.shape, np.iinfo(np.int64).max))
    check_twins(claims, cells, twins)
    _check_starts(claims, cells, starts, pieces, twins)
    Pieces(claims, cells, pieces, flows, starts, *owner).check()
    return int(np.isfinite(bound).any(axis=0).sum())


def _owners(
    claims: Claims, starts: np.ndarray, pieces: np.ndarray, flows: np.ndarray, total: int
) -> list[np.ndarray]:
    """Return the starts of pieces and flows, having looked at all numbers that point somewhere."""
    labels, count, most = len(claims.controls), len(pieces), VERTICES if claims.space.n == 2 else 2
    for records, field, least, end in (
        (starts, "held", 0, labels), (starts, "cell", 0, total), (starts, "wave", 0, 1 << 31),
        (pieces, "held", 0, labels), (pieces, "samples", 0, 1 << 31), (pieces, "ended", 0, 2),
        (pieces, "merged", -1, count), (pieces, "count", min(most, 2) - 1, most + 1),
        (flows, "label", 0, labels), (flows, "samples", 1, 1 << 31), (flows, "waits", 0, 2),
        (flows, "start", 0, count), (flows, "end", 0, count),
        (flows, "count", min(most, 2) - 1, most + 1),
    ):  # fmt: skip
        good = (records[field] >= least) & (records[field] < end)
        need(good, f"{field} {{}} is out of range")
    for records in (pieces, flows):
        points, error = points_of(records, claims.space.n), records["error"]
        need(np.isfinite(points).all(axis=(1, 2)), "points {} are no numbers")
        need(((error >= 0) & np.isfinite(error)).all(axis=1), "error {} is none")
        if claims.space.n != 2:
            need((points[:, 0] <= points[:, 1]).all(axis=1), "box {} is none")
    need(pieces["id"] == np.arange(count), "piece {} has another number")
    owners = []
    for name, records in (("piece", pieces), ("flow", flows)):
        ends = np.append(starts[name], len(records))
        need(
            (np.diff(ends) >= (name == "piece")) & (starts[name] >= 0), f"start {{}} has no {name}"
        )
        need([ends[0] == 0], f"a {name} is of no start")
        owners.append(spread(ends[:-1], ends[1:] - 1)[1])
    return owners


def _check_starts(
    claims: Claims, cells: Cells, starts: np.ndarray, pieces: np.ndarray, twins: np.ndarray
) -> None:
    """Refuse bounds of cells without a proof; `cells` get the waves of those that have one."""
    first = pieces[starts["piece"]]
    low, high = starts["lower"], starts["upper"]
    four = corners(low, high, VERTICES).reshape(len(starts), pieces["v"].shape[1])
    used = np.arange(four.shape[1]) < first["count"][:, None] * claims.space.n
    begins = ((first["v"] == four) | ~used).all(axis=1) & (first["samples"] == 0)
    begins &= (first["held"] == starts["held"]) & (
        first["count"] == (4 if claims.space.n == 2 else 2)
    )
    need(begins & (low <= high).all(axis=1), "start {} is not its first piece")
    late = np.ones(len(pieces), bool)
    late[starts["piece"]] = False
    need(~late | (pieces["samples"] > 0), "piece {} begins, and is no start")
    good = np.isfinite(np.concatenate([low, high, starts["bound"][:, None]], axis=1)).all(axis=1)
    need(good & (starts["bound"] >= 0), "start {} has no numbers")
    box = cells.boxes(starts["cell"])
    room = CLOSED * (cells.upper - cells.lower) / cells.counts
    need(((low >= box[0]) & (high <= box[1] + room)).all(axis=1), "start {} is beyond its cell")
    need(
        claims.layered | (starts["held"] == len(claims.controls) - 1), "start {} has another label"
    )
    whole = np.flatnonzero(((low <= box[0]) & (high >= box[1])).all(axis=1))
    layer = starts["held"][whole] if claims.layered else np.zeros(len(whole), dtype=int)
    cell = starts["cell"][whole]
    same = cells.bound[layer, cell] == starts["bound"][whole]
    need(same, "the bound of cell {} is not that of its start", cell)
    cells.wave[layer, cell] = starts["wave"][whole]
    cells.wave[:] = cells.wave[twins, np.arange(cells.wave.shape[1])]
    inside = np.zeros(cells.bound.shape[1], bool)
    at_once = np.flatnonzero((cells.bound == 0).any(axis=0))
    box = cells.boxes(at_once)
    inside[at_once] = truth(claims.target, *box)[0] & ~truth(claims.avoid, *box)[1]
    cells.wave[(cells.bound == 0) & inside] = -1
    proved = (cells.wave < np.iinfo(np.int64).max) | np.isinf(cells.bound)
    need(proved.all(axis=0), "the bound of cell {} has no proof")
