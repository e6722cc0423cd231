"""Sets of states as programs: whether a state is in a target."""

from __future__ import annotations

from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.domain import Ball, Box
from capsyn.programs.builder import ProgramBuilder
from capsyn.programs.program import Ports, Program
from capsyn.validation import describe, finite_number

Target = Ball | Box | Program
"""A set of states; of a program ``x -> inside``, those where it is not 0."""

INSIDE = (("inside", 1),)


def check_target(target: Any, domain: Box, name: str = "target") -> None:
    """Raise `ProblemError` unless a target is None, or a set of states that meets the domain."""
    if target is None:
        return
    if isinstance(target, Program):
        if target.inputs != (("x", domain.n),) or target.outputs != INSIDE:
            raise ProblemError(
                f"`{name}` must be a program of {domain.n} state(s), (x: {domain.n}) -> "
                f"(inside: 1); got {_told(target.inputs)} -> {_told(target.outputs)}"
            )
        return
    if not isinstance(target, (Ball, Box)):
        raise ProblemError(
            f"`{name}` must be a Ball, a Box or a function of the state; got {describe(target)}"
        )
    if isinstance(target, Box) and name != "initial":  # the only set that may have no volume
        target.check_wide(name)
    axes = target_axes(target, domain, name)
    lower, upper, periodic = domain.lower[axes], domain.upper[axes], np.array(domain.periodic)[axes]
    if isinstance(target, Ball):
        off = np.where(periodic, 0.0, target.center - np.clip(target.center, lower, upper))
        meets = np.linalg.norm(off) <= target.radius
    else:
        meets = (periodic | ((target.lower <= upper) & (target.upper >= lower))).all()
    if not meets:
        raise ProblemError(f"`{name}` must meet the domain; it lies outside")


def _told(ports: Ports) -> str:
    return f"({', '.join(f'{name}: {size}' for name, size in ports)})"


def target_axes(target: Ball | Box, domain: Box, name: str = "target") -> list[int]:
    """Return the axes of the domain that a ball or box is about.

    They are those that its names say; all of them in order for a ball without names, and for a box
    whose names are those that boxes have unless told. Others are a `ProblemError`.
    """
    names = target.names or ()
    if names and set(names) <= set(domain.names):
        return [domain.names.index(axis) for axis in names]
    unnamed = not names or (isinstance(target, Box) and names == Box.unnamed(target.n))
    if not unnamed:
        wrong = next(axis for axis in names if axis not in domain.names)
        raise ProblemError(
            f"`{name}` must name states among {', '.join(domain.names)}; got '{wrong}'"
        )
    if target.n != domain.n:
        raise ProblemError(
            f"`{name}` must have {domain.n} dimension(s), or name some of the states "
            f"{', '.join(domain.names)}; got {target.n}"
        )
    return list(range(domain.n))


def check_initial(initial: Any, domain: Box) -> None:
    """Raise `ProblemError` unless it is a ball or box of some states of the domain, or None."""
    if initial is None:
        return
    if not isinstance(initial, (Ball, Box)):
        raise ProblemError(f"`initial` must be a Ball or a Box; got {describe(initial)}")
    check_target(initial, domain, "initial")


def placed(states: np.ndarray, initial: Ball | Box | None, domain: Box, seed: Any) -> np.ndarray:
    """Return states (B, n), those along the axes of `initial` drawn from it, in place."""
    if initial is not None:
        states[:, target_axes(initial, domain)] = initial.sample(len(states), seed)
    return states


def with_tolerance(target: Any, tolerance: float | None) -> Any:
    """Return a target with another radius where one is given; `ProblemError` if it is no ball."""
    if tolerance is None:
        return target
    if not isinstance(target, Ball):
        raise ProblemError(
            f"`tolerance` must be given with a target that is a ball only; got {describe(target)}"
        )
    return Ball(target.center, finite_number("tolerance", tolerance, above=0.0), target.names)


def describe_target(target: Target, domain: Box) -> str:
    """Return a target in words."""
    if isinstance(target, Program):
        return f"a condition of {len(target.instructions)} operations"
    names = [domain.names[i] for i in target_axes(target, domain)]
    if isinstance(target, Ball):
        center = ", ".join(f"{v:g}" for v in target.center)
        return f"ball of radius {target.radius:g} around {', '.join(names)} = {center}"
    return ", ".join(
        f"{name} in [{low:g}, {high:g}]" if low < high else f"{name} = {low:g}"
        for name, low, high in zip(names, target.lower, target.upper)
    )


def target_program(target: Target | None, domain: Box) -> Program:
    """Return the program ``x -> inside`` of a target, 1 inside and 0 outside; None has no inside.

    On periodic axes the distance to a ball's centre is the shorter one, and a box comes again every
    period.
    """
    if isinstance(target, Program):
        return target
    builder = ProgramBuilder()
    x = [builder.input() for _ in range(domain.n)]
    apply, constant = builder.apply, builder.constant

    result = constant(0.0)
    if isinstance(target, Ball):
        distance = constant(0.0)
        for i, center in zip(target_axes(target, domain), target.center):
            off = apply("sub", x[i], constant(center))
            if domain.periodic[i]:
                off = apply("remainder", off, constant(domain.widths[i]))
            distance = apply("add", distance, apply("mul", off, off))
        result = apply("le", distance, constant(target.radius * target.radius))
    elif isinstance(target, Box):
        result = constant(1.0)
        for i, low, high in zip(target_axes(target, domain), target.lower, target.upper):
            lower, upper = constant(low), constant(high)
            within = apply("and", apply("le", lower, x[i]), apply("le", x[i], upper))
            if domain.periodic[i]:  # or some periods away
                off, width = apply("sub", x[i], lower), constant(domain.widths[i])
                turns = apply("floor", apply("div", off, width))
                rest = apply("sub", off, apply("mul", width, turns))
                near = apply("le", rest, apply("sub", upper, lower))
                within = apply("or", within, near)
            result = apply("and", result, within)
    return builder.build("target", (("x", domain.n),), INSIDE, [result])
