"""Proofs of arrival in files, and changes of them after which they prove less than they say."""

import copy
import functools
import io
import json
import math

import numpy as np

from capsyn.certification.certify import simulated_arrival
from capsyn.certification.check import check_proof, claims_of
from capsyn.certification.proof_file import ArrivalProof
from capsyn.errors import CertificateError
from capsyn.reach.arrive import arrive
from capsyn.reach.kernel import Follower
from support.proofs.attack import asked_of, little_effort
from support.proofs.random_loops import KINDS, Case, random_case


@functools.cache
def proved_case(seed: int) -> tuple[Case, ArrivalProof]:
    """Return a random loop, of kind `seed` modulo their number, and the proof of its arrival."""
    case = random_case(np.random.default_rng(seed), KINDS[seed % len(KINDS)])
    with little_effort():
        asked = asked_of(case)
        follower = Follower.build(asked.loop, asked.cells, 1)
        when = simulated_arrival(asked)
        arrival = arrive(follower, when, asked.starts, asked.box, math.inf)
    return case, ArrivalProof(asked, arrival)


@functools.cache
def _bytes(seed: int, path: str) -> bytes:
    proved_case(seed)[1].save(path)
    with open(path, "rb") as file:
        return file.read()


def proof_arrays(seed: int, path: str) -> dict[str, np.ndarray]:
    """Return the arrays of the file of such a proof, written to a path; anyone may change them."""
    with np.load(io.BytesIO(_bytes(seed, str(path)))) as file:
        return {name: file[name] for name in file}


def refusal(case: Case, arrays: dict[str, np.ndarray]) -> str | None:
    """Return why a proof is refused, None where it is not."""
    try:
        with np.errstate(all="ignore"):
            head = json.loads(arrays["header"].tobytes())
            check_proof(claims_of(head, case.policy), arrays)
    except CertificateError as error:
        return str(error)
    return None


def _header(arrays, change):
    head = json.loads(arrays["header"].tobytes())
    change(head)
    arrays["header"] = np.frombuffer(json.dumps(head).encode(), dtype=np.uint8)
    return True


def _one(rng, rows):
    return int(rng.choice(rows)) if len(rows) else None


def _ends(arrays):
    """Return the pieces that flows end in, and nothing is merged into."""
    pieces = arrays["pieces"]
    into = np.setdiff1d(arrays["flows"]["end"], pieces["merged"][pieces["merged"] >= 0])
    return into


def vertex(arrays, rng):
    """Move a vertex of a piece whose error has no room for that inwards by 1e-6 of a cell."""
    k = _one(rng, _ends(arrays))
    if k is None:
        return False
    piece, n = arrays["pieces"][k], arrays["lower"].shape[0]
    points = piece["v"].reshape(-1, n)[: piece["count"]]
    size = 1e-6 * ((arrays["upper"] - arrays["lower"]) / arrays["counts"])
    i = int(rng.integers(len(points)))
    inwards = points.mean(axis=0) - points[i]
    flat = np.ptp(points, axis=0).min() < 1e3 * size.min()
    if flat or piece["error"].max() > 1e-3 * size.min():
        return False
    points[i] += inwards * (size.min() / np.linalg.norm(inwards))
    return True


def fewer(arrays, rng):
    """Take the last vertex away."""
    k = _one(rng, _ends(arrays))
    if k is None or arrays["pieces"]["count"][k] < 4 or arrays["lower"].shape[0] != 2:
        return False
    points = arrays["pieces"]["v"][k].reshape(-1, 2)
    last = arrays["pieces"]["count"][k] - 1
    a, b, c = points[last - 1], points[last], points[0]
    if (
        abs((b - a)[0] * (c - b)[1] - (b - a)[1] * (c - b)[0])
        < 1e-6 * np.ptp(points, axis=0).prod()
    ):
        return False  # it is no corner
    arrays["pieces"]["count"][k] -= 1
    return True


def error(arrays, rng):
    k = _one(rng, _ends(arrays))
    if k is None:
        return False
    arrays["pieces"]["error"][k] = 0
    return True


def _other(rng, old, count):
    return (old + 1 + int(rng.integers(count - 1))) % count


def label(arrays, rng):
    k, labels = _one(rng, np.arange(len(arrays["flows"]))), _labels(arrays)
    if k is None:
        return False
    arrays["flows"]["label"][k] = _other(rng, arrays["flows"]["label"][k], labels)
    return True


def _labels(arrays):
    return len(json.loads(arrays["header"].tobytes())["controls"])


def held(arrays, rng):
    k = _one(rng, _ends(arrays))
    if k is None:
        return False
    arrays["pieces"]["held"][k] = _other(rng, arrays["pieces"]["held"][k], _labels(arrays))
    return True


def samples(arrays, rng):
    k = _one(rng, _ends(arrays))
    if k is None:
        return False
    arrays["pieces"]["samples"][k] += rng.choice([-1, 1])
    return True


def shorter(arrays, rng):
    """Let a flow and all after it seem shorter: it ends elsewhere."""
    k = _one(rng, np.flatnonzero(arrays["flows"]["samples"] > 1))
    if k is None:
        return False
    arrays["flows"]["samples"][k] -= 1
    arrays["pieces"]["samples"][arrays["flows"]["end"][k]] -= 1
    return True


def bound(arrays, rng):
    """Lower the time of a start, and of its cell in all layers that have it."""
    starts = arrays["starts"]
    k = _one(rng, np.arange(len(starts)))
    if k is None:
        return False
    cell, old = starts["cell"][k], starts["bound"][k]
    here = arrays["bound"][:, cell]
    here[here == old] = starts["bound"][k] = old * (1 - 1e-9)
    return True


def sooner(arrays, rng):
    """Say that a cell is in the target."""
    layer, cell = np.nonzero(arrays["bound"] > 0)
    k = _one(rng, np.arange(len(layer)))
    if k is None:
        return False
    arrays["bound"][layer[k], cell[k]] = 0.0
    return True


def proved(arrays, rng):
    layer, cell = np.nonzero(np.isinf(arrays["bound"]))
    k = _one(rng, np.arange(len(layer)))
    if k is None:
        return False
    arrays["bound"][layer[k], cell[k]] = 1.0
    return True


def removed(arrays, rng):
    """Remove the only flow of a piece."""
    flows = arrays["flows"]
    piece, place, count = np.unique(flows["start"], return_index=True, return_counts=True)
    k = _one(rng, place[count == 1])
    if k is None:
        return False
    arrays["flows"] = np.delete(flows, k)
    arrays["starts"]["flow"] -= arrays["starts"]["flow"] > k
    return True


def narrower(arrays, rng):
    """Let a part that flows, the only one of a piece, be 1e-6 of a cell narrower."""
    flows, n = arrays["flows"], arrays["lower"].shape[0]
    piece, place, count = np.unique(flows["start"], return_index=True, return_counts=True)
    k = _one(rng, place[count == 1])
    if k is None:
        return False
    points = flows[k]["v"].reshape(-1, n)[: flows[k]["count"]]
    points += 1e-6 * (points.mean(axis=0) - points)
    return True


def ended(arrays, rng):
    pieces = arrays["pieces"]
    k = _one(rng, np.flatnonzero((pieces["ended"] == 0) & (pieces["merged"] < 0)))
    if k is None:
        return False
    pieces["ended"][k] = 1
    return True


def open_(arrays, rng):
    k = _one(rng, np.flatnonzero(arrays["pieces"]["ended"]))
    if k is None:
        return False
    arrays["pieces"]["ended"][k] = 0
    return True


def merged(arrays, rng):
    pieces = arrays["pieces"]
    k = _one(rng, np.flatnonzero(pieces["merged"] < 0))
    if k is None or k + 1 == len(pieces):
        return False
    pieces["ended"][k] = 0
    pieces["merged"][k] = int(rng.integers(k + 1, len(pieces)))
    one, other = pieces[k], pieces[pieces["merged"][k]]
    return not np.array_equal(one["v"], other["v"])


def twin(arrays, rng):
    twins, bounds = arrays["twins"], arrays["bound"]
    layer, cell = np.nonzero(np.isfinite(bounds) & (bounds > 0))
    k = _one(rng, np.arange(len(layer)))
    if k is None or len(twins) < 2:
        return False
    new = _other(rng, layer[k], len(twins))
    if bounds[new, cell[k]] == bounds[layer[k], cell[k]]:
        return False
    twins[layer[k], cell[k]] = new
    return True


def wave(arrays, rng):
    """Prove a start before the cells that it ends in."""
    starts, pieces = arrays["starts"], arrays["pieces"]
    period = json.loads(arrays["header"].tobytes())["period"]
    last = np.append(starts["piece"][1:], len(pieces))
    reached = [pieces[a:b]["samples"].max() * period for a, b in zip(starts["piece"], last)]
    k = _one(rng, np.flatnonzero(starts["bound"] > np.array(reached) * (1 + 1e-9)))
    if k is None:
        return False
    starts["wave"][k] = 0
    return True


def end(arrays, rng):
    k = _one(rng, np.arange(len(arrays["flows"])))
    if k is None:
        return False
    old = arrays["flows"]["end"][k]
    new = _other(rng, old, len(arrays["pieces"]))
    one, other = arrays["pieces"][old], arrays["pieces"][new]
    arrays["flows"]["end"][k] = new
    return not (np.array_equal(one["v"], other["v"]) and one["held"] == other["held"])


def start(arrays, rng):
    k = _one(rng, np.arange(len(arrays["starts"])))
    if k is None:
        return False
    arrays["starts"]["lower" if rng.random() < 0.5 else "upper"][k] *= 1 + 1e-6
    return True


def period(arrays, rng):
    def change(head):
        head["period"] *= 1 + rng.choice([-1, 1]) * 1e-3
        head["delay"] = min(head["delay"], head["period"])

    return len(arrays["flows"]) > 0 and _header(arrays, change)


def noise(arrays, rng):
    if not len(arrays["flows"]):
        return False
    width = (arrays["upper"] - arrays["lower"]) / arrays["counts"]
    return _header(
        arrays, lambda head: head.update(noise=(np.array(head["noise"]) + width).tolist())
    )


def controls(arrays, rng):
    def change(head):
        head["controls"][int(rng.integers(len(head["controls"])))][0] += 1e-9

    return _header(arrays, change)


def policy(arrays, rng):
    return _header(arrays, lambda head: head.update(policy=head["policy"][::-1]))


CHANGES = (
    vertex, fewer, error, label, held, samples, shorter, bound, sooner, proved, removed, narrower,
    ended, open_, merged, twin, wave, end, start, period, noise, controls, policy,
)  # fmt: skip


def tampered(arrays, change, rng):
    """Return a copy of arrays that is changed, None where there is nothing to change so."""
    copied = copy.deepcopy(arrays)
    return copied if change(copied, rng) else None
