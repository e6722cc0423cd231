"""The pieces of a proof: how the checker goes through each, its parts and where they flow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsyn.certification.checker.cells import Cells, Claims, chunks, need, points_of, spread, truth
from capsyn.certification.checker.moving import (
    AFFINE,
    CHANGES,
    FACES,
    LEFT,
    NARROWER,
    REASONS,
    UNLABELLED,
    Moving,
)
from capsyn.certification.checker.sets import around, within
from capsyn.errors import CertificateError

TURN = 16
"""Most samples in which a label that is held is followed at once."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces and flows, of the starts (each) that they are of."""

    claims: Claims
    cells: Cells
    pieces: np.ndarray
    flows: np.ndarray
    starts: np.ndarray
    piece_start: np.ndarray  # of each piece
    flow_start: np.ndarray

    def check(self) -> None:
        """Go through all.

        Raises
        ------
        CertificateError
            The first that does not hold.
        """
        pieces = self.pieces
        merged, ended = pieces["merged"] >= 0, pieces["ended"] != 0
        need(~(merged & ended), "piece {} is merged, and ended")
        for rows in chunks(np.flatnonzero(merged)):
            self.check_merged(rows)
        for rows in chunks(np.flatnonzero(ended)):
            self.check_ended(rows)
        order = np.argsort(self.flows["start"], kind="stable")
        first = np.searchsorted(self.flows["start"][order], np.arange(len(pieces) + 1))
        for rows in chunks(np.flatnonzero(~merged & ~ended)):
            self.check_parts(rows, order, first)
        # those that are alike are gone through together
        groups = np.lexsort((self.flows["samples"], self.flows["waits"]))
        for rows in chunks(groups, 1 << 15):
            self.check_flows(rows)

    def _sets(self, records: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return points_of(records, self.claims.space.n), records["error"]

    def check_merged(self, rows: np.ndarray) -> None:
        """Refuse pieces that are not in those that they are merged into, which come later."""
        one = self.pieces[rows]
        other = self.pieces[one["merged"]]
        alike = (one["samples"] == other["samples"]) & (one["held"] == other["held"])
        alike &= (one["merged"] > rows) & (
            self.piece_start[rows] == self.piece_start[one["merged"]]
        )
        need(alike, "piece {} is merged into one that is not like it", rows)
        need(
            within(*self._sets(one), *self._sets(other)),
            "piece {} is not in what it is merged into",
            rows,
        )

    def check_ended(self, rows: np.ndarray) -> None:
        """Refuse pieces that end neither in the target nor over cells that were proved before."""
        one, start = self.pieces[rows], self.starts[self.piece_start[rows]]
        need(one["samples"] > 0, "piece {} ends at the start", rows)
        points, error = self._sets(one)
        low, high = around(points, error * (1 + 1e-12))
        inside, _ = truth(self.claims.target, low, high)
        later, left = np.zeros(len(rows)), np.flatnonzero(~inside)
        layer = one["held"] if self.claims.layered else np.zeros_like(one["held"])
        later[left] = self.cells.later(
            self.claims, points[left], error[left], layer[left], start["wave"][left]
        )
        need(np.isfinite(later), "piece {} ends where not all cells are proved before", rows)
        arrived = one["samples"] * self.claims.period + later
        need(arrived <= start["bound"] * (1 + 1e-12), "piece {} arrives later than is said", rows)

    def check_parts(self, rows: np.ndarray, order: np.ndarray, first: np.ndarray) -> None:
        """Refuse pieces of which a part that gets a label flows nowhere under it.

        `order` are the flows by their pieces, of which each begins at `first`.
        """
        claims, one = self.claims, self.pieces[rows]
        points, error = self._sets(one)
        whole = (one["samples"] == 0) & ~claims.noise.any()  # half-open cells themselves
        low, high = around(points, error)
        need(~whole | ~error.any(axis=1), "piece {} starts with an error", rows)
        need(
            ~self._lost(low, high, claims.noise > 0), "piece {} is measured beyond the domain", rows
        )
        reach = np.where(whole[:, None], 0.0, claims.reach(low, high))
        high = np.where(whole[:, None], np.nextafter(high, -np.inf), high + reach)
        box, leaf, moved = claims.tree.under(low - reach, high, ~whole)
        reach = reach + error
        label = claims.next[claims.tree.row[leaf], one["held"][box]]
        # which flows a part may be in
        flow, part = spread(first[rows[box]], first[rows[box] + 1] - 1)
        flow = order[flow]
        flows, piece = self.flows[flow], one[box[part]]
        fits = (flows["label"] == label[part]) & (flows["samples"] > 0)
        done = np.zeros((2, len(box)), bool)  # not held, held
        same = (flows["v"] == piece["v"]).all(axis=1) & (flows["count"] == piece["count"])
        same &= (flows["error"] >= piece["error"]).all(axis=1) & fits
        np.logical_or.at(done, (flows["waits"], part), same)
        asked = self._asked(one["held"][box], one["samples"][box], label)
        left = np.flatnonzero((asked & ~done).any(axis=0))
        cut, alive = claims.tree.cut(points[box[left]], reach[box[left]], leaf[left], moved[left])
        left, cut = left[alive], cut[alive]
        at = np.full(len(box), -1)
        at[left] = np.arange(len(left))
        pairs = np.flatnonzero(fits & (at[part] >= 0))
        for some in chunks(pairs):
            inside = within(cut[at[part[some]]], error[box[part[some]]], *self._sets(flows[some]))
            np.logical_or.at(done, (flows["waits"][some], part[some]), inside)
        need(
            (~asked | done)[:, left].all(axis=0),
            "a part of piece {} flows nowhere",
            rows[box[left]],
        )

    def _asked(self, held: np.ndarray, samples: np.ndarray, label: np.ndarray) -> np.ndarray:
        """Return whether labels (B,) must be followed as not held, and as held, (2, B)."""
        claims = self.claims
        change, holds = claims.kinds[label] != claims.kinds[held], claims.holds[label] > 1
        begins = (samples == 0) & (held == len(claims.controls) - 1)
        return np.stack([~(holds & change) | (label < 0), holds & (change | begins)])

    def check_flows(self, rows: np.ndarray) -> None:
        """Refuse flows that do not end in their pieces, or go where they must not."""
        claims, flows = self.claims, self.flows[rows]
        before, after = self.pieces[flows["start"]], self.pieces[flows["end"]]
        own = self.piece_start[flows["start"]] == self.flow_start[rows]
        own &= self.piece_start[flows["end"]] == self.flow_start[rows]
        own &= after["held"] == flows["label"]
        own &= after["samples"] == before["samples"].astype(np.int64) + flows["samples"]
        need(own, "flow {} ends in a piece that is not its own", rows)
        label, waits, count = flows["label"], flows["waits"] == 1, flows["samples"]
        need(~waits | (count == claims.holds[label]), "flow {} is held otherwise", rows)
        for choice in (NARROWER, AFFINE, FACES):
            why = self._follow(rows, choice)
            rows, why = rows[why > 0], why[why > 0]
            if not len(rows):
                return
        raise CertificateError(f"flow {rows[0]} {REASONS[why[0]]}")

    def _follow(self, rows: np.ndarray, choice: int) -> np.ndarray:
        """Return why flows (B,) do not do what they say, numbers of `REASONS`, 0 where they do."""
        claims, flows = self.claims, self.flows[rows]
        label, waits, count = flows["label"], flows["waits"] == 1, flows["samples"]
        held = self.pieces["held"][flows["start"]]
        sets = Moving(claims, *self._sets(flows), choice)
        lag = np.where((held != label) & (claims.delay > 0), claims.delay, 0.0)
        sets.move(claims.controls[held], lag, True)
        left, u = count.astype(np.int64), claims.controls[label]
        while (left > 0).any():
            now = np.where(waits, np.minimum(left, TURN), left)
            left = left - now
            sets.move(u, np.maximum(now * claims.period - lag, 0.0), left > 0)
            lag = np.zeros(len(rows))
        sets.end(*self._sets(self.pieces[flows["end"]]))
        some = np.flatnonzero(waits | (count > 1))  # the policy is asked on the way
        low, high, held = sets.low[some], sets.high[some], waits[some]
        sets.fail(some, self._lost(low, high, claims.noise > 0), UNLABELLED)
        sets.fail(some, self._lost(low, high, True) & ~held, LEFT)
        reach = claims.reach(low, high)
        low, high = low - reach, high + reach
        box, leaf, moved = claims.tree.under(low, high)
        own = label[some[box]]
        found = claims.next[claims.tree.row[leaf], own]
        bad = np.where(held[box], (found < 0) | claims.drifts[own, found], found != own)
        box, leaf, moved = box[bad], leaf[bad], moved[bad]
        bad = claims.tree.met(low[box], high[box], leaf, moved)
        sets.fail(some[box], bad, CHANGES)
        return sets.why

    def _lost(self, low: np.ndarray, high: np.ndarray, axes: np.ndarray | bool) -> np.ndarray:
        """Return which boxes (B, n) may be measured beyond the domain on some axes."""
        space, noise = self.claims.space, self.claims.noise
        beyond = (low - noise < space.lower) | (high + noise > space.upper)
        return (beyond & axes & ~(np.array(space.periodic) | self.claims.nearest)).any(axis=1)
