"""A control problem as its user states it: a system, a goal and an alphabet, all checked."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet, Outside, check_outside
from capsyn.modelling.discrete import check_discrete, check_samples
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.exogenous import check_exogenous, joined, of_states
from capsyn.modelling.expressions import casadi_function, expression, split_reading
from capsyn.modelling.grid import LEAVES, Grid
from capsyn.modelling.settings import SsacSettings
from capsyn.modelling.switching import Switching, check_switching
from capsyn.modelling.tails.riccati import FIT, NO_RUNNING_COST, riccati_tail, tail_effort
from capsyn.modelling.tails.tail import Tail
from capsyn.modelling.targets import check_target
from capsyn.modelling.time_unit import check_time_unit
from capsyn.notebook import table
from capsyn.validation import describe, finite_number, keep, one_of, true_or_false


@dataclass(frozen=True, eq=False)
class Problem:
    """A control problem: a system, a goal and an alphabet, which is all that a synthesis needs.

    Parameters
    ----------
    name : str
        Name of the problem.
    dynamics : callable ``(x, u) -> n components``, or ``(x, u, w)``
        The rates of the states, eq. (1) of the paper [state unit / time unit]. `x`, `u` and `w`
        (the exogenous inputs, if any) are CasADi column vectors. CasADi functions and NumPy ufuncs
        both work on them.
    domain : Box
        The states that get a symbol.
    alphabet : Alphabet, or (N, m) or (N,) numbers
        The symbols [input units].
    default : (m,) or float, or callable ``x -> u`` or ``(x, w) -> u``
        The control that predictions use [input units]. The default need not be a symbol. A
        prediction follows a law at every instant, and its adjoint belongs to ``f(x, default(x, w),
        w)``.
    horizon : float
        Prediction horizon T > 0 [time unit]. None takes the horizon that a Riccati tail proposes.
    running_cost, terminal_cost : callables ``x -> scalar``, or ``(x, w)``, optional
        The costs of eq. (3) [cost / time unit] and [cost], without a factor 1/2. Give at least one.
    target : Ball, Box or callable ``x -> true or false``, or ``(x, w)``, optional
        The states that count as arrived. The policy carries the target.
    outside : "error", "nearest" or symbol
        What a state outside the domain gets. The policy carries this rule.
    min_dwell : float
        Least time between switches [time unit], which the policy carries. `min_dwell` is short for
        one ``hold`` for all symbols; the policy then does not depend on the symbol in force.
    settings : SsacSettings
        Options of the controller.
    partitions, refinement : int or (n,), or (n + k,) with k exogenous inputs
        Cells of the root grid along each axis, and children of a split cell along each axis.
    max_level : int
        How often a cell may be split along an axis.
    description : str
        One line for ``capsyn list``.
    time_unit : "ns", "us", "ms", "s", "min", "h" or "d"
        The unit of every time of the model, given or returned. The policy carries it.
    outside_at_once : bool
        Whether the symbol of a state outside the domain is taken at once, without waiting for
        `min_dwell`. The symbol of a state that is not finite never waits. The policy carries this.
    switching : Switching, optional
        Prices on switching, least times and forbidden transitions. The policy carries them, and
        then depends on the symbol in force. The symbol in force stays if it ties with the best.
    delay : float
        Known time from a sample until its control acts [time unit]. The policy compensates the
        delay: it decides for the state to which the symbol in force leads during the delay.
    exogenous : Box, optional
        Bounds, names and units of what the controller is told at every sample beside the state:
        setpoints, references, measured disturbances. Predictions keep these values constant. The
        policy is then a function of both, ``policy(x, w)``. What the controller is not told is a
        parameter of the plant, see ``parameters`` of `capsyn.simulate`.
    leaves : "constant" or "affine"
        "constant" gives each cell one symbol. "affine" gives cells on a switching surface rows that
        are affine in the state. Affine leaves take far fewer solves and cells from three dimensions
        on, see `subdivide`. If you change `leaves`, choose `partitions` and `max_level`
        again.
    tail : "riccati", "riccati:EFFORT", "fit" or callable ``x -> scalar``, or ``(x, w)``, optional
        A terminal cost that stands for the cost after the horizon, in place of `terminal_cost`. A
        tail is a function, or is made by `riccati_tail`. For "fit", `synthesize` finds it with
        `fitted_tail`. Give a short horizon with a tail.
    limits : callable ``x -> components``, or ``(x, w)``, optional
        Functions that must stay <= 0, each component of them. The policy keeps the limits by
        construction if `synthesize` is told ``keep_limits``. The policy's model carries them.
    discrete : bool
        Whether the dynamics are a map ``x+ = F(x, u)``, the states one sample later [state unit].
        The `horizon` of such a problem is a whole number of samples. Running costs, effort and
        prices are per sample, and are summed over samples.
    sample_time : float, optional
        Sample time of closed loops [time unit], in place of that of `settings`. A `discrete`
        problem must give the sample time of its map, and its loops use only this one.

    Raises
    ------
    ProblemError
        A field that cannot be used. The error names the field in one line.
    """

    name: str
    dynamics: Callable[..., Any]
    domain: Box
    alphabet: Alphabet
    default: Any
    horizon: float
    running_cost: Callable[..., Any] | None = None
    terminal_cost: Callable[..., Any] | None = None
    target: Ball | Box | Callable[..., Any] | None = None
    outside: Outside = "error"
    min_dwell: float = 0.0
    settings: SsacSettings = field(default_factory=SsacSettings)
    partitions: Any = 9
    refinement: Any = 2
    max_level: int = 4
    description: str = ""
    time_unit: str = "s"
    outside_at_once: bool = False
    switching: Switching | None = None
    delay: float = 0.0
    exogenous: Box | None = None
    leaves: str = "constant"
    tail: Any = None
    limits: Callable[..., Any] | None = None
    discrete: bool = False
    sample_time: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip() or not self.name.isprintable():
            raise ProblemError(f"`name` must be a printable string; got {describe(self.name)}")
        if not isinstance(self.domain, Box):
            raise ProblemError(f"`domain` must be a capsyn.Box; got {describe(self.domain)}")
        self.domain.check_wide("domain")
        if not isinstance(self.alphabet, Alphabet):
            keep(self, alphabet=Alphabet(self.alphabet))
        keep(self, exogenous=check_exogenous(self.exogenous, self.domain, self.alphabet))
        check_time_unit(self.time_unit)
        true_or_false("outside_at_once", self.outside_at_once)
        if not callable(self.default):
            keep(self, default=self.alphabet.control("default", self.default))
        keep(self, min_dwell=finite_number("min_dwell", self.min_dwell, least=0.0))
        keep(self, outside=check_outside(self.outside, self.alphabet))
        keep(self, delay=finite_number("delay", self.delay, least=0.0))
        if not isinstance(self.settings, SsacSettings):
            raise ProblemError(
                f"`settings` must be a capsyn.SsacSettings; got {describe(self.settings)}"
            )
        self.settings.efforts(self.alphabet.values)
        check_discrete(self)
        if self.has_law and self.settings.on_no_descent == "default":
            raise ProblemError(
                "`on_no_descent` must be 'best' where `default` is a law: a policy gives symbols; "
                "got 'default'"
            )
        keep(self, target=of_states(self.target, self.domain, self.exogenous))
        if isinstance(self.target, (Ball, Box)) or not callable(self.target):
            check_target(self.target, self.space)
        grid = Grid.of(self.partitions, self.refinement, self.max_level, self.space.n)
        keep(self, **vars(grid))
        one_of("leaves", self.leaves, LEAVES)
        if self.running_cost is None and self.terminal_cost is None and self.tail is None:
            raise ProblemError(
                "`running_cost` and `terminal_cost` must not both be None: there is no goal"
            )
        for name in ("dynamics", "running_cost", "terminal_cost", "limits"):
            value = getattr(self, name)
            if value is None and name != "dynamics":
                continue
            if not callable(value):
                raise ProblemError(f"`{name}` must be a function; got {describe(value)}")
        if self.tail is not None and not callable(self.tail):
            tail_effort(self.tail)
        if self.tail == FIT:
            if self.running_cost is None:
                raise ProblemError(NO_RUNNING_COST)
            self.system()  # is checked; its tail is yet to be found
        else:
            terminal = self.functions() and self.terminal
            if self.horizon is None and isinstance(terminal, Tail):
                keep(self, horizon=terminal.horizon)
        keep(self, horizon=finite_number("horizon", self.horizon, above=0.0))
        check_samples(self)
        self._keep_sample_time()
        if callable(self.target):
            arguments = split_reading(ca.SX.sym("z", self.space.n), {}, self.domain.n)
            expression("target", self.target, arguments, 1)
        check_switching(self)

    def _keep_sample_time(self) -> None:
        vars(self)["_says_sample_time"] = self.settings.sample_time is not None
        keep(self, settings=self.settings.sampled(self.horizon))

    @property
    def grid(self) -> Grid:
        """The grid of cells."""
        return Grid(self.partitions, self.refinement, self.max_level)

    @functools.cached_property
    def space(self) -> Box:
        """The box that cells divide: the axes of the domain, then those of the exogenous inputs."""
        return joined(self.domain, self.exogenous)

    @functools.cached_property
    def terminal(self) -> Callable[..., Any] | None:
        """The terminal cost, or the tail in its place; None without either.

        Raises
        ------
        ProblemError
            The tail is "fit", which `synthesize` finds, or a Riccati tail that does not exist.
        """
        if not isinstance(self.tail, str):
            return self.tail or self.terminal_cost
        effort = tail_effort(self.tail)
        if effort is None:
            raise ProblemError(
                "`tail` 'fit' is found by `synthesize`; here it must be given, as "
                "`capsyn.fitted_tail(problem)` returns it"
            )
        return riccati_tail(self, effort)

    @property
    def has_law(self) -> bool:
        """Whether the default control is a law and not a constant."""
        return callable(self.default)

    def _repr_html_(self) -> str:
        """Return the axes, symbols and times as a table for notebooks."""
        box, alphabet = self.space, self.alphabet
        kinds = ["state"] * self.domain.n + ["exogenous input"] * (box.n - self.domain.n)
        rows: list[Any] = [
            (f"{name} [{unit}]" if unit else name, kind, f"{low:.4g} to {high:.4g}"
             + (", periodic" if around else ""))
            for name, unit, kind, low, high, around in zip(
                box.names, box.units, kinds, box.lower, box.upper, box.periodic
            )
        ]  # fmt: skip
        for i, (name, unit) in enumerate(zip(alphabet.inputs, alphabet.units)):
            values = alphabet.values[:, i]
            span = f"{values.min():.4g} to {values.max():.4g}"
            rows.append((f"{name} [{unit}]" if unit else name, "input", span))
        names = ", ".join(alphabet.names[:MOST_NAMED])
        more = ", .." if len(alphabet) > MOST_NAMED else ""
        rows.append((f"{len(alphabet)} symbols", "alphabet", names + more))
        if self.horizon is not None:
            unit = "samples" if self.discrete else self.time_unit
            rows.append(("horizon", "", f"{self.horizon:g} {unit}"))
        return table(f"Problem '{self.name}'", rows)

    @functools.cached_property
    def default_control(self) -> np.ndarray:
        """The default control (m,) as a constant: for a law, its value in the middle of the space.

        A policy uses this control before its first decision, and where no decision is found.

        Raises
        ------
        ProblemError
            A law that is not finite in the middle of the space.
        """
        if not self.has_law:
            return np.asarray(self.default)
        middle = (self.space.lower + self.space.upper) / 2
        value = np.array(self.functions()["default"](middle)).reshape(-1)
        if not np.isfinite(value).all():
            raise ProblemError(
                f"`default` must be finite at the middle of the domain; got {value.tolist()}"
            )
        return self.alphabet.control("default", value)

    def functions(self) -> dict[str, ca.Function]:
        """Return the problem's CasADi functions of the reading z = (x, w), by name.

        Without exogenous inputs, z is the state. The functions are ``dynamics(z, u)`` (under which
        w stays), ``running_cost(z)`` and ``terminal_cost(z)``, which is the tail if there is one.
        There may also be ``default(z)`` for a law, and ``limits(z)``. A cost that is None is the
        constant 0.
        """
        z = ca.SX.sym("z", self.space.n)
        name = "terminal_cost" if self.tail is None else "tail"
        arguments = split_reading(z, {}, self.domain.n)
        terminal = expression(name, self.terminal or (lambda *_: 0.0), arguments, 1)
        return {**self.system(), "terminal_cost": casadi_function("terminal_cost", [z], terminal)}

    def system(self) -> dict[str, ca.Function]:
        """Return the `functions` but the terminal cost, and the ``motion(z, u)`` of tails."""
        z, u = ca.SX.sym("z", self.space.n), ca.SX.sym("u", self.alphabet.m)
        n, told = self.domain.n, self.space.n - self.domain.n
        arguments = split_reading(z, {}, n)
        running = self.running_cost or (lambda *_: 0.0)
        values = {"running_cost": expression("running_cost", running, arguments, 1)}
        if self.has_law:
            values["default"] = expression("default", self.default, arguments, self.alphabet.m)
        if self.limits is not None:
            values["limits"] = expression("limits", self.limits, arguments, None)
        functions = {name: casadi_function(name, [z], value) for name, value in values.items()}
        rates = expression("dynamics", self.dynamics, split_reading(z, {"u": u}, n), n, rates=True)
        rates = ca.vertcat(rates, z[n:] if told and self.discrete else ca.SX.zeros(told))
        functions["motion"] = casadi_function("dynamics", [z, u], rates - self.discrete * z)
        return {"dynamics": casadi_function("dynamics", [z, u], rates), **functions}

    def replace(self, **changes: Any) -> Problem:
        """Return the problem with some fields replaced, as in ``replace(horizon=2.0)``.

        `changes` gives the new fields by name. The result is checked like a new problem. A grid
        with the same numbers along all axes has them along those of another space, too. A sample
        time that the problem does not say follows the horizon.

        Raises
        ------
        ProblemError
            A value that cannot be used.
        """
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        for name in ("partitions", "refinement"):
            if len(each := set(fields[name])) == 1 and changes.keys() & {"domain", "exogenous"}:
                (fields[name],) = each
        said = vars(self)["_says_sample_time"]
        changes["settings"] = self.settings.replaced(changes.get("settings", self.settings), said)
        changed = object.__new__(type(self))
        if not changes.keys() & _OF_TAILS and "terminal" in vars(self):
            vars(changed)["terminal"] = self.terminal  # a tail takes a while
        Problem.__init__(changed, **fields | changes)
        return changed


MOST_NAMED = 12
"""Most symbols that a notebook names."""
_OF_TAILS = frozenset(
    "dynamics domain alphabet exogenous running_cost terminal_cost target tail discrete".split()
)
"""Fields that a terminal cost, or a tail in its place, depends on."""
