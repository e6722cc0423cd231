"""A proof of arrival as a file: every set on the way, for whoever checks it."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from capsyn.certification.question import Question
from capsyn.execution.files import atomic_write
from capsyn.policies.file import content_hash
from capsyn.reach.arrive import Arrival, in_target
from capsyn.reach.kernel import PROVED, Follower

FORMAT = 1
ROOM = 4
"""Pieces for each that flows, and then some: those that are merged are told, too."""


@dataclass(frozen=True, eq=False)
class ArrivalProof:
    """How it was proved that cells arrive; the sets on the way are found again to be written."""

    asked: Question
    arrival: Arrival

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the proof: a NumPy archive without objects.

        ``header`` is JSON as bytes: the loop, and the SHA-256 of the policy's content. Cells are in
        C order of the grid ``lower``, ``upper``, ``counts``; ``bound`` (layers, K) is when they
        have arrived at the latest, ``twins`` (layers, K) the layer whose proof is theirs. Proofs
        are of ``starts``, in order; those of a wave may end in cells of earlier waves. See `Told`.
        """
        loop, cells, arrival = self.asked.loop, self.asked.cells, self.arrival
        header = {
            "format": FORMAT,
            "policy": content_hash(self.asked.policy),
            "space": loop.space.to_json(),
            "states": loop.moving,
            **{
                name: getattr(loop, name).to_json()
                for name in ("rates", "slopes", "breaks", "target", "avoid")
            },
            **{name: getattr(loop, name).tolist() for name in ("controls", "holds", "kinds")},
            "parameters": loop.parameters.tolist(),
            "noise": loop.noise.tolist(),
            "period": loop.period,
            "delay": loop.delay,
            "nearest": loop.nearest,
            "layered": loop.layered,
        }
        pieces, flows, starts = self._told()
        arrays = {
            "header": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8),
            "lower": cells.lower, "upper": cells.upper, "counts": np.asarray(cells.counts),
            "bound": arrival.bound, "twins": arrival.twins.astype(np.int32),
            "starts": starts, "pieces": pieces, "flows": flows,
        }  # fmt: skip

        def write(temporary: Path) -> None:
            with temporary.open("wb") as file:
                np.savez_compressed(file, allow_pickle=False, **arrays)

        atomic_write(path, write)

    def _told(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return all pieces, flows and starts, going through the waves again."""
        loop, cells, arrival = self.asked.loop, self.asked.cells, self.arrival
        follower = Follower.build(loop, cells, 1)
        follower.bound[:, in_target(loop, cells)] = 0.0
        n = loop.space.n
        record = np.dtype(
            [("lower", float, n), ("upper", float, n), ("held", np.int32), ("cell", np.int64),
             ("wave", np.int32), ("bound", float), ("piece", np.int64), ("flow", np.int64)]
        )  # fmt: skip
        all_pieces, all_flows, starts = [], [], []
        pieces_before = flows_before = 0
        whole_lower, whole_upper = cells.boxes(np.arange(cells.total))
        for number, wave in enumerate(arrival.waves):
            room = ROOM * wave.work + 64 + 4 * len(wave.held)
            found, told = follower.tell(wave.lower, wave.upper, wave.held, wave.effort, room)
            if (needed := int(told.ends.max())) > room:  # those that are merged may be many
                found, told = follower.tell(wave.lower, wave.upper, wave.held, wave.effort, needed)
            assert (found.status == PROVED).all(), "a proof must come out the same again"
            own = np.zeros(len(wave.held), record)
            ends = np.concatenate([np.zeros((1, 2), dtype=np.int64), told.ends])
            pieces, flows = told.pieces[: ends[-1, 0]].copy(), told.flows[: ends[-1, 1]].copy()
            for name, values in (
                ("lower", wave.lower), ("upper", wave.upper), ("held", wave.held),
                ("cell", wave.cells), ("wave", number), ("bound", found.bound),
                ("piece", ends[:-1, 0] + pieces_before), ("flow", ends[:-1, 1] + flows_before),
            ):  # fmt: skip
                own[name] = values
            pieces["id"] += pieces_before
            pieces["merged"][pieces["merged"] >= 0] += pieces_before
            flows["start"] += pieces_before
            flows["end"] += pieces_before
            pieces_before += len(pieces)
            flows_before += len(flows)
            all_pieces.append(pieces)
            all_flows.append(flows)
            starts.append(own)
            whole = (wave.lower <= whole_lower[wave.cells]).all(axis=1)
            whole &= (wave.upper >= whole_upper[wave.cells]).all(axis=1)
            layer = loop.layer_of(wave.held)
            for other in range(loop.layers):
                same = whole & (arrival.twins[other, wave.cells] == layer)
                follower.bound[other, wave.cells[same]] = found.bound[same]
        if not starts:
            return _told_nothing(follower, record)
        return np.concatenate(all_pieces), np.concatenate(all_flows), np.concatenate(starts)


def _told_nothing(
    follower: Follower, record: np.dtype
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return no pieces, flows and starts."""
    n = follower.loop.space.n
    _, told = follower.tell(np.empty((0, n)), np.empty((0, n)), np.empty(0), 0, 0)
    return told.pieces, told.flows, np.zeros(0, record)
