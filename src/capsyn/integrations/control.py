"""python-control: policies and plants as its input/output systems.

All times, `dt` too, are in the unit of time of the problem or policy.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.integrations.single_lookup import single_lookup
from capsyn.integrations.stepping import has_memory, stepper
from capsyn.policies.policy import Policy
from capsyn.simulation.plant import choose_substeps, plant_of
from capsyn.validation import describe, finite_number, whole_number

try:
    import control
except ImportError:
    raise ProblemError(
        "`capsyn.integrations.control` needs python-control: pip install 'capsyn[control]'"
    ) from None


def policy_system(
    policy: Policy, dt: float = 0.0, name: str = "policy"
) -> control.NonlinearIOSystem:
    """Return a policy as a system: states, then exogenous inputs, are inputs; controls are outputs.

    The system is static, unless the policy depends on the symbol in force or its `Switching` has
    least times. Such a system has these states, all 0 at the start. ``in_force`` is 0 before the
    first decision, and then 1 more than the symbol, or N + 1 for the default control. ``held``
    counts the samples for which the symbol has been held. ``held_INPUT`` counts the samples for
    which each input has been held.

    Parameters
    ----------
    policy : Policy
        The policy, with its rule outside the domain, its switching and its least times.
    dt : float
        Sample time [time unit of the policy], or 0 for a system in continuous time. Only a static
        system can be in continuous time. A loop that chatters needs samples, because a solver in
        continuous time shrinks its steps without end at a switching surface.
    name : str
        Name of the system.

    Raises
    ------
    ProblemError
        An argument that cannot be used.
    """
    if not isinstance(policy, Policy):
        raise ProblemError(f"`policy` must be a capsyn.Policy; got {describe(policy)}")

    dt = finite_number("dt", dt, least=0.0)
    ports = {"inputs": list(policy.space.names), "outputs": list(policy.alphabet.inputs)}
    if not has_memory(policy):
        look_up = single_lookup(policy)

        def output(time: float, x: Any, u: Any, params: Any) -> np.ndarray:
            return policy.controls[look_up(u)]

        return control.NonlinearIOSystem(None, output, dt=dt, name=name, **ports)
    if not dt:
        raise ProblemError(
            "`dt` must be above 0 for a policy that depends on the symbol in force or has least "
            "times; got 0"
        )
    step = stepper(policy, dt)
    return control.NonlinearIOSystem(
        lambda time, x, u, params: step(u, np.asarray(x))[1],
        lambda time, x, u, params: policy.controls[step(u, np.asarray(x))[0]],
        states=["in_force", "held", *(f"held_{name}" for name in policy.alphabet.inputs)],
        dt=dt,
        name=name,
        **ports,
    )


def plant_system(
    model: Any, dt: float = 0.0, substeps: int | None = None, name: str = "plant"
) -> control.NonlinearIOSystem:
    """Return the plant of a problem or policy as a system: controls are inputs, states are outputs.

    Exogenous inputs are further inputs after the controls, with their names. Exogenous inputs are
    held over a sample.

    Parameters
    ----------
    model : Problem or Policy
        The problem, or policy with a model, that has the dynamics. The model must have no delay.
    dt : float
        Sample time [time unit of the model], or 0 for a system in continuous time. Over a sample,
        the control is held and the state integrated, as `capsyn.simulate` does.
    substeps : int, optional
        Runge-Kutta steps per sample. Default: as many as a step-doubling check asks for.
    name : str
        Name of the system.

    Raises
    ------
    ProblemError
        An argument that cannot be used.
    """
    dt = finite_number("dt", dt, least=0.0)
    plant = plant_of(lambda time, states: states, model)
    if plant.delay:
        raise ProblemError(
            "`model` must have no delay, which this system would not have; got "
            f"{plant.delay:g} {plant.time_unit}: take `replace(delay=0)` and a delay before it"
        )
    plant.check_loop("dt", dt, substeps)
    if substeps is not None:
        substeps = whole_number("substeps", substeps, least=1)
        if not dt:
            raise ProblemError("`substeps` must be given with a sample time `dt` only")
    elif dt:
        controls = np.vstack([plant.alphabet.values, plant.default])
        substeps = choose_substeps(plant, controls, np.zeros((0, 1)), dt)
    none, n, m = np.zeros((0, 1)), plant.states, plant.m
    names, inputs = plant.space.names, plant.alphabet.inputs

    def update(time: float, x: Any, u: Any, params: Any) -> np.ndarray:
        held, told = np.split(np.atleast_1d(u)[:, None], [m])
        reading = np.concatenate([np.asarray(x, dtype=float)[:, None], told])
        if substeps is None:
            return plant.rates(reading, held, none)[:n, 0]
        still, whole = np.zeros_like(reading), np.full(1, dt)
        end, _ = plant.advance(reading, np.zeros(1), held, none, still, whole, substeps)
        return end[:n, 0]

    return control.NonlinearIOSystem(
        update,
        None,
        inputs=[*inputs, *names[n:]],
        outputs=list(names[:n]),
        states=list(names[:n]),
        dt=dt,
        name=name,
    )
