"""Sequential action control: the schedule of continuous controls, as a program."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.settings import SsacSettings
from capsyn.programs.builder import ProgramBuilder
from capsyn.programs.model import Model
from capsyn.programs.program import Program, is_affine
from capsyn.validation import describe, is_list


def sac_program(model: Model, alphabet: Alphabet, settings: SsacSettings, limits: Any) -> Program:
    """Return SAC's schedule ``(x, u, rho, alpha) -> (control, gradient)``.

    Lambda has rank one, so that ``u* = R^-1 v (v . u + alpha) / (1 + v . R^-1 v)``, v = h^T rho.
    """
    n, m = dict(model.dynamics.inputs)["x"], alphabet.m
    if not is_affine(model.dynamics, "u"):
        raise ProblemError("`dynamics` must be affine in u for the method 'sac'")
    weight = np.asarray(settings.control_weight) * (
        np.eye(m) if np.ndim(settings.control_weight) == 0 else 1
    )
    if np.linalg.eigvalsh(weight).min() <= 0:
        raise ProblemError("`control_weight` must be positive definite for the method 'sac'")
    inverse = np.linalg.inv(weight)
    lower, upper = alphabet.values.min(axis=0), alphabet.values.max(axis=0)
    if limits is not None:
        if not is_list(limits, 2):
            raise ProblemError(f"`limits` must be (lower, upper); got {describe(limits)}")
        lower, upper = (alphabet.control("limits", value) for value in limits)
        if (lower > upper).any():
            raise ProblemError(f"`limits` must have lower <= upper; got {describe(limits)}")
    builder = ProgramBuilder()
    ports = (("x", n), ("u", m), ("rho", n), ("alpha", 1))
    x, u, rho, alpha = ([builder.input() for _ in range(size)] for _, size in ports)
    apply, constant = builder.apply, builder.constant

    def dot(a: list[int], b: list[int]) -> int:
        return functools.reduce(
            lambda total, pair: apply("add", total, apply("mul", *pair)), zip(a, b), constant(0.0)
        )

    zero = [constant(0.0)] * m
    drift = builder.call(model.dynamics, x, zero)
    v = []
    for i in range(m):
        unit = [constant(float(i == j)) for j in range(m)]
        rates = builder.call(model.dynamics, x, unit)
        v.append(dot(rho, [apply("sub", a, b) for a, b in zip(rates, drift)]))
    weighted = [dot([constant(value) for value in row], v) for row in inverse]
    size = apply(
        "div", apply("add", dot(v, u), alpha[0]), apply("add", constant(1.0), dot(v, weighted))
    )
    control = [
        apply("fmin", apply("fmax", apply("mul", w, size), constant(low)), constant(high))
        for w, low, high in zip(weighted, lower, upper)
    ]
    gradient = dot(v, [apply("sub", a, b) for a, b in zip(control, u)])
    return builder.build("sac", ports, (("control", m), ("gradient", 1)), [*control, gradient])
