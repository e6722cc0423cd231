"""What a target is, and what it makes of a plan."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from capsyn.exports.golden import Golden
from capsyn.exports.plan import Files, Plan
from capsyn.exports.sequence import Sequence


@dataclass(frozen=True)
class Exported:
    """Files of a target, and what a user must be told.

    `renamed` are names that are no identifiers of the language, and what they became. `changed` is
    the share of random states in the domain whose symbol is another than the policy's, as numbers
    are rounded for the target; None: no state at all, since the target rounds to the policy's own
    lattice. `golden` are vectors of readings as the target holds them; None: those of the plan.
    `written` says how the tree is written where that is not as it is, as plain data. `beside` is
    the folder, with a slash at its end, of vectors and costs. `plan` is the plan as it was written,
    where a tree was taken for cells, or cells for a tree, and `chosen` what the target took for
    options that were left to it. `sequence` are runs of such readings as `golden` has.
    """

    files: Files
    renamed: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    changed: float | None = None
    golden: Golden | None = None
    written: Mapping[str, Any] | None = None
    beside: str = ""
    plan: Plan | None = None
    chosen: Mapping[str, Any] = field(default_factory=dict)
    sequence: Sequence | None = None


@dataclass(frozen=True)
class NameOption:
    """The option of targets that have no other.

    Parameters
    ----------
    name : str, optional
        What the file is called, made an identifier. Default: the policy's name.
    """

    name: str | None = None


@dataclass(frozen=True)
class Target:
    """A language that policies are exported to.

    ``export(plan, golden, options)`` makes its files; `options` is a frozen dataclass, each with a
    default. `planes` is whether it takes trees with oblique splits, `features` whether it takes
    those with features, `cells` whether it writes the cells of a policy with affine leaves instead
    of a tree, `remembers` whether it takes what has more to remember than one least time: the
    symbol in force, least times of symbols and inputs, a hold-off. ``measure(plan, golden,
    exported, options)`` gives what is measured of its files here, as plain data; None: nothing.
    """

    export: Callable[[Plan, Golden, Any], Exported]
    options: type = NameOption
    planes: bool = True
    features: bool = False
    cells: bool = True
    remembers: bool = False
    measure: Callable[[Plan, Golden, Exported, Any], dict[str, Any]] | None = None

    @property
    def option_names(self) -> tuple[str, ...]:
        """Names of the options, in order."""
        return tuple(option.name for option in fields(self.options))

    def files(self, plan: Plan, golden: Golden, **options: Any) -> Exported:
        """Return what the target makes of a plan, with options by name."""
        return self.export(plan, golden, self.options(**options))
