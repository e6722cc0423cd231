"""What the fields of a policy must be, and the symbols in force that it is asked with."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from capsyn.cells.affine_leaves import PriceRatios
from capsyn.errors import PolicyFormatError, ProblemError
from capsyn.limits.kept import Kept
from capsyn.modelling.alphabet import Alphabet, check_outside
from capsyn.modelling.discrete import check_map
from capsyn.modelling.exogenous import check_exogenous, of_states
from capsyn.modelling.switching import DEFAULT, check_switching
from capsyn.modelling.targets import check_target
from capsyn.modelling.time_unit import NAMES, check_time_unit
from capsyn.validation import describe, finite_number, keep, read_only, true_or_false

STATISTICS: dict[str, tuple[type, ...]] = {
    "solves": (int,),
    "solves_by_role": (dict,),
    "cells": (int,),
    "worst_case_solves": (int,),
    "indifferent_points": (int,),
    "not_finite_points": (int,),
    "not_finite_example": (list, type(None)),
    "limit_points": (int,),
    "limit_example": (list,),
    "stopped_by_max_solves": (bool,),
    "stopped_by": (str,),
    "sample": (dict,),
    "table": (dict,),
    "source": (dict,),
    "limits": (dict,),
}
"""What statistics hold, if they hold it; there may be more."""
RATIOS = ("wanted_over_reachable", "effort_over_choice", "reach")
TABLE = ("points", "outside", "several")
SAMPLE = tuple("states no_descent held_back indifferent not_finite negative_cost".split()) + RATIOS

KINDS = ("chosen", "own", "uniform", "random")
"""Kinds of alphabets in a table: that of the search, those of the user, and two to compare with."""
SIZES = ("cells", "solves", "nodes", "bytes")
"""What the policy of an alphabet takes."""
BOUNDS = ("objective", "low", "high")
"""The mean of the objective, and its interval."""
SHARES = ("success", "success_low", "success_high")
MOST_ROWS, MOST_NAMES = 1000, 100
"""Most rows of a table, and most figures or weights by name."""


def check_fields(policy: Any, structure: type) -> None:
    """Raise `ProblemError` unless the fields fit each other, and keep them as they were checked.

    `structure` is the type of the cells.
    """
    if not isinstance(policy.name, str) or not policy.name.isprintable():
        raise ProblemError(f"`name` must be a printable string; got {describe(policy.name)}")
    policy.domain.check_wide("domain")
    keep(policy, exogenous=check_exogenous(policy.exogenous, policy.domain, policy.alphabet))
    keep(policy, default=policy.alphabet.control("default", policy.default))
    keep(policy, outside=check_outside(policy.outside, policy.alphabet))
    check_time_unit(policy.time_unit)
    keep(policy, min_dwell=finite_number("min_dwell", policy.min_dwell, least=0.0))
    keep(policy, target=of_states(policy.target, policy.domain, policy.exogenous))
    check_target(policy.target, policy.space)
    true_or_false("gaps", policy.gaps)
    true_or_false("outside_at_once", policy.outside_at_once)
    if policy.horizon is not None:
        keep(policy, horizon=finite_number("horizon", policy.horizon, above=0.0))
    if policy.settings is not None:
        policy.settings.efforts(policy.alphabet.values)
        if policy.settings.sample_time is None:
            if policy.horizon is None:
                raise ProblemError("`settings` must say a `sample_time` for a policy of no horizon")
            keep(policy, settings=policy.settings.sampled(policy.horizon))
    cells: Any = policy.cells
    if not isinstance(cells, structure):
        raise ProblemError(f"`cells` must be a {structure.__name__}; got {describe(cells)}")
    if policy.cells.n != policy.space.n:
        raise ProblemError(
            f"`cells` must have {policy.space.n} axes like the domain; got {policy.cells.n}"
        )
    check_switching(policy)
    keep(policy, delay=finite_number("delay", policy.delay, least=0.0))
    check_map(policy)
    keep(policy, transitions=_checked_transitions(policy.transitions, len(policy.alphabet) + 1))
    policy.cells.check(len(policy.alphabet) + 1, policy.transitions)
    _check_forbidden(policy)
    kept = policy.kept
    if kept is not None:
        fits = isinstance(kept, Kept) and kept.cells.n == policy.space.n
        if not fits or kept.rows.shape[1] not in (1, len(policy.alphabet) + 1):
            raise ProblemError(f"`kept` must be a Kept of this domain; got {describe(kept)}")


def _checked_transitions(transitions: Any, count: int) -> np.ndarray:
    """Return a table of rows (R, N + 1), int32 and read-only, of so many labels, N + 1."""
    constant = _constant_rows(count)
    if transitions is None:
        return constant
    table = np.asarray(transitions)
    if np.array_equal(table, _constant_rows(len(table))):  # of any alphabet
        return constant
    wide = table.ndim == 2 and table.shape[0] >= count and table.shape[1] == count
    if table.dtype.kind not in "iu" or not wide:
        raise ProblemError(
            f"`transitions` must be a table of whole numbers (R, {count}), R >= {count}; got "
            f"{table.dtype} of shape {table.shape}"
        )
    if (table < 0).any() or (table >= count).any() or (table[:count] != constant).any():
        raise ProblemError(
            f"`transitions` must be labels 0 to {count - 1}, its first {count} rows constant"
        )
    rows = table[count:].astype(np.int64)
    differ = rows[1:] - rows[:-1]
    first = np.argmax(differ != 0, axis=1)[:, None]
    ordered = (np.take_along_axis(differ, first, axis=1) > 0).all()
    if not ordered or (rows == rows[:, :1]).all(axis=1).any():
        raise ProblemError(
            f"`transitions` must ascend from row {count} on, row by row, with none that is constant"
        )
    return read_only(table.astype(np.int32))


def _constant_rows(count: int) -> np.ndarray:
    """Return the rows (K, K) of labels that follow whatever is in force; no memory is taken."""
    return np.broadcast_to(np.arange(count, dtype=np.int32)[:, None], (count, count))


def _check_forbidden(policy: Any) -> None:
    """Raise unless no leaf takes a forbidden transition, and prices are numbers."""
    if policy.switching is None:
        return
    if policy.switching.has_share:
        raise ProblemError(
            f"`switching` must have a price in numbers; got {describe(policy.switching.price)}"
        )
    forbidden = policy.rules.forbidden
    if forbidden.any():
        used = np.unique(policy.cells.constant_leaves(len(policy.transitions)))
        taken = policy.transitions[used]
        if forbidden[np.arange(taken.shape[1]), taken].any():
            raise ProblemError("`transitions` must not take a forbidden transition; it does")
    affine = getattr(policy.cells, "affine", None)
    if affine is not None:
        wanted = PriceRatios.of(policy.rules.prices).ratios
        if affine.ratios is None or not np.array_equal(affine.ratios, wanted):
            raise ProblemError("the prices of affine leaves must be those of `switching`")


def labels_in_force(current: Any, shape: tuple[int, ...], alphabet: Alphabet) -> np.ndarray | None:
    """Return the labels in force (B,) for states of a shape (...), checked; None: the default's."""
    if current is None:
        return None
    count = len(alphabet)
    if isinstance(current, str):
        names = [*alphabet.names, DEFAULT]
        if current not in names:
            raise ProblemError(
                f"`current` must be a symbol ({', '.join(names)}); got {describe(current)}"
            )
        current = names.index(current)
    labels = np.asarray(current)
    if labels.dtype.kind not in "iu" or (labels < -1).any() or (labels > count).any():
        raise ProblemError(f"`current` must be symbols, -1 to {count - 1}; got {describe(current)}")
    try:
        labels = np.broadcast_to(labels, shape)
    except ValueError:
        raise ProblemError(
            f"`current` must be of shape {shape}, one symbol for each state; got {labels.shape}"
        ) from None
    labels = labels.reshape(-1).astype(np.int32)
    return np.where(labels < 0, np.int32(count), labels)


def checked_statistics(data: Any) -> dict[str, Any]:
    """Return statistics if what is in them is of the kinds that this version writes."""
    if not isinstance(data, dict):
        raise PolicyFormatError("its statistics are no object")
    for key, kinds in STATISTICS.items():
        if key in data and not isinstance(data[key], kinds):
            raise PolicyFormatError(f"its statistic '{key}' is of another kind")
    roles, sample = data.get("solves_by_role", {}), data.get("sample", {})
    if not all(isinstance(count, int) for count in roles.values()):
        raise PolicyFormatError("its statistic 'solves_by_role' is of another kind")
    numbers = all(
        isinstance(v, (int, float)) or (v is None and k in RATIOS) for k, v in sample.items()
    )
    table = data.get("table", {})
    if table and not (set(table) == set(TABLE) and all(type(v) is int for v in table.values())):
        raise PolicyFormatError("its statistic 'table' is of another kind")
    if sample and (not set(sample) >= set(SAMPLE) or not numbers):
        raise PolicyFormatError("its statistic 'sample' is of another kind")
    if "alphabet" in data and not is_alphabet_study(data["alphabet"]):
        raise PolicyFormatError("its statistic 'alphabet' is of another kind")
    return data


def checked_row(row: dict[str, Any]) -> None:
    """Raise `ProblemError` unless the figures of a row are what a study writes."""
    if row.get("kind") not in KINDS:
        raise ProblemError(f"a row of the table is of no kind; got {describe(row.get('kind'))}")
    wrong = [name for name in ("count", "tried") if not _is_count(row.get(name), least=1)]
    wrong += [name for name in ("lost",) if not _is_count(row.get(name))]
    wrong += [name for name in SIZES if name not in row or not _is_known(row[name], _is_count)]
    wrong += [name for name in BOUNDS if name not in row or not _is_known(row[name], _is_number)]
    wrong += [name for name in SHARES if name not in row or not _is_known(row[name], _is_share)]
    if not is_named(row.get("figures")):
        wrong.append("figures")
    if wrong:
        raise ProblemError(f"a row of the table has a wrong {wrong[0]}")


def is_named(data: Any) -> bool:
    """Return whether plain data is finite numbers by name, and not too many."""
    return (
        isinstance(data, dict)
        and len(data) <= MOST_NAMES
        and all(isinstance(name, str) and name.isprintable() for name in data)
        and all(map(_is_number, data.values()))
    )


def is_alphabet_study(data: Any) -> bool:
    """Return whether plain data is what a policy's statistics say of the study of its alphabet."""
    if not isinstance(data, dict) or not is_named(data.get("objective")):
        return False
    rows, texts = data.get("rows"), [data.get(name) for name in ("problem", "time_unit")]
    if not isinstance(rows, list) or len(rows) > MOST_ROWS:
        return False
    if not all(isinstance(text, str) and text.isprintable() for text in texts):
        return False
    if not all(isinstance(row, dict) and _is_count(row.get("alphabet"), 1) for row in rows):
        return False
    try:
        for row in rows:
            checked_row(row)
    except ProblemError:
        return False
    counts = [data.get(name) for name in ("count", "fresh", "searched", "candidates")]
    return texts[1] in NAMES and all(map(_is_count, counts))


def _is_known(value: Any, fits: Any) -> bool:
    return value is None or bool(fits(value))


def _is_count(value: Any, least: int = 0) -> bool:
    return type(value) is int and least <= value < 1 << 53


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= sys.float_info.max


def _is_share(value: Any) -> bool:
    return _is_number(value) and 0 <= value <= 1
