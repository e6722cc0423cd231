"""Golden vectors: states with the symbols and the statuses that an export must give."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass

import numpy as np

from capsyn.exports.plan import NOT_FINITE, OK, OUTSIDE, Plan
from capsyn.random_streams import stream

INSIDE = 1000
"""Random states in the domain."""
AT_FACES = 300
"""States per axis on random faces of the lattice, and as many one rounding before and behind."""
GOLDEN = 7
"""Purpose of the random states."""


@dataclass(frozen=True, eq=False)
class Golden:
    """States (K, n) [state units], lattice steps (K, n), labels (K,) and statuses (K,).

    Steps are those of the nearest state in the domain, 0 where a state is not finite. Readings
    (K, n) are what an export gets: the states themselves, or, where a plan has a scale or an
    offset, numbers of which the states are ``reading * scale + offset``. `in_force` (K,) are the
    labels in force, where a policy remembers; else None.
    """

    states: np.ndarray
    steps: np.ndarray
    labels: np.ndarray
    statuses: np.ndarray
    readings: np.ndarray
    in_force: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.labels)

    def to_csv(self, plan: Plan) -> bytes:
        """Return the vectors as CSV: readings in full precision, steps, symbol, status.

        Where a policy remembers, ``in_force`` is before the symbol, which follows it. First come
        the lines of the plan's header, each after a ``#``.
        """
        whole = {f"step_{i}": column for i, column in enumerate(self.steps.T)}
        if self.in_force is not None:
            whole["in_force"] = self.in_force
        return table(
            plan, self.readings, {}, {**whole, "symbol": self.labels, "status": self.statuses}
        )


def table(
    plan: Plan, readings: np.ndarray, first: dict[str, np.ndarray], last: dict[str, np.ndarray]
) -> bytes:
    """Return a CSV of readings (K, n) between columns (K,) of whole numbers, after the header."""
    names = plan.policy.space.names
    head = io.StringIO()
    csv.writer(head, lineterminator="").writerow([*first, *names, *last])
    columns = head.getvalue()
    if columns.startswith("#"):  # no remark
        columns = f'"{names[0]}"{columns[len(names[0]) :]}'
    rows = [*(f"# {line}" for line in plan.header), columns]
    columns_before, columns_after = ([c.tolist() for c in part.values()] for part in (first, last))
    for k, reading in enumerate(readings.tolist()):
        before, after = ([str(c[k]) for c in part] for part in (columns_before, columns_after))
        rows.append(",".join([*before, *map(repr, reading), *after]))
    return ("\n".join(rows) + "\n").encode()


def golden_vectors(plan: Plan) -> Golden:
    """Return vectors in cells, on faces, edges, corners and seams, outside, NaN and infinite.

    At least 2,000, the same for the same policy.
    """
    domain, counts, n = plan.policy.space, plan.counts, plan.n
    rng = stream(0, GOLDEN)
    inside = domain.lower + rng.random((INSIDE, n)) * domain.widths
    # on faces of some axes (all of them: corners), and the floats beside them
    at = np.repeat(inside[rng.integers(INSIDE, size=AT_FACES * n)], 3, axis=0)
    for i, count in enumerate(counts):
        on = np.repeat(rng.random(AT_FACES * n) < (0.5 if n > 1 else 1), 3)
        on[3 * AT_FACES * i : 3 * AT_FACES * (i + 1)] = True
        face = np.repeat(rng.integers(count + 1, size=AT_FACES * n), 3)
        place = domain.faces(i, face, count)
        beside = np.stack(
            [np.nextafter(place[::3], -np.inf), place[1::3], np.nextafter(place[2::3], np.inf)]
        )
        at[on, i] = beside.T.ravel()[on]
    outside = domain.lower + (3 * rng.random((200, n)) - 1) * domain.widths
    bounds = np.stack(
        [domain.lower, domain.upper, domain.lower - domain.widths, domain.upper + domain.widths]
    )
    corners = bounds[rng.integers(4, size=(200, n)), np.arange(n)]
    lost = inside[:60].copy()
    lost[np.arange(60), rng.integers(n, size=60)] = np.resize([np.nan, np.inf, -np.inf], 60)
    if plan.folded:
        at = np.repeat(at[1::3], 3, axis=0)  # readings are told apart below
    states = np.concatenate([inside, at, outside, corners])
    if plan.folded:
        readings = _readings(plan, states)
        readings[INSIDE // 2 : INSIDE] = np.rint(readings[INSIDE // 2 : INSIDE])  # as counts
        states = readings
    return decide(plan, np.concatenate([states, lost]))


def _readings(plan: Plan, states: np.ndarray) -> np.ndarray:
    """Return readings (K, n) at which the rounded state passes the states (K, n).

    In turn the last one before, and the next two, so that three equal states are told apart.
    """
    lower, upper = plan.policy.space.lower, plan.policy.space.upper
    most = np.maximum(np.maximum(abs(lower), abs(upper)), np.maximum(abs(states), abs(plan.offset)))
    with np.errstate(over="ignore", invalid="ignore"):
        near = (states - plan.offset) / plan.scale
        reach = 8 * (np.spacing(most) / abs(plan.scale) + np.spacing(abs(near)))
    before, behind = near - reach, near + reach
    while True:
        middle = before + (behind - before) / 2
        between = (before < middle) & (middle < behind)
        if not between.any():
            break
        passed = (plan.states(middle) >= states) == (plan.scale > 0)
        behind = np.where(between & passed, middle, behind)
        before = np.where(between & ~passed, middle, before)
    turn = np.arange(len(states))[:, None] % 3
    return np.where(turn == 0, before, np.where(turn == 1, behind, np.nextafter(behind, np.inf)))


def decide(plan: Plan, readings: np.ndarray, in_force: np.ndarray | None = None) -> Golden:
    """Return what an export must give for readings (K, n), which are states by default.

    Where a policy remembers they are decided with the labels `in_force` (K,), by default all labels
    in turn.
    """
    if plan.policy.remembers and in_force is None:
        in_force = (np.arange(len(readings)) * 7 // 5) % plan.labels
    found = Found.of(plan, readings)
    labels, statuses = found.decide(plan, in_force)
    return Golden(found.states, found.steps, labels, statuses, readings, in_force)


@dataclass(frozen=True, eq=False)
class Found:
    """What decisions at readings (K, n) have in common, whatever label is in force.

    These are states (K, n), their lattice steps (K, n), which are finite, which are inside the
    domain, and the rows (K,) of their cells, which are None where these depend on the label.
    """

    states: np.ndarray
    steps: np.ndarray
    finite: np.ndarray
    inside: np.ndarray
    rows: np.ndarray | None

    @staticmethod
    def of(plan: Plan, readings: np.ndarray) -> Found:
        """Return what there is at readings (K, n)."""
        domain, cells, states = plan.policy.space, plan.policy.cells, plan.states(readings)
        finite = np.isfinite(states).all(axis=1)
        steps = np.zeros(states.shape, dtype=np.int64)
        steps[finite] = domain.locate(states[finite], cells.counts)
        rows = None if cells.priced else cells.labels(steps)
        return Found(states, steps, finite, domain.contains(states), rows)

    def at(self, rows: slice) -> Found:
        """Return that of some readings."""
        some = None if self.rows is None else self.rows[rows]
        return Found(
            self.states[rows], self.steps[rows], self.finite[rows], self.inside[rows], some
        )

    def decide(self, plan: Plan, in_force: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return labels (K,) and statuses (K,), with labels in force (K,) where there are any."""
        labels = self.rows
        if labels is None:
            labels = plan.policy.cells.labels(self.steps, in_force)
        if in_force is not None:
            labels = plan.policy.transitions[labels, in_force]
        labels = np.where(self.finite if plan.nearest else self.inside, labels, plan.safe)
        inside = self.inside & (labels != plan.gap)
        labels = np.where(labels == plan.gap, plan.safe, labels)
        return labels, np.where(self.finite, np.where(inside, OK, OUTSIDE), NOT_FINITE)
