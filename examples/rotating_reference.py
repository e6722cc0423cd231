"""A current that follows a sine: its angle is a state, its speed and amplitude are told.

A bridge puts -48, 0 or 48 V on a coil. The reference is ``amplitude * sin(angle)``, and the angle's
rate is the speed that the controller is told: so it knows where the reference goes next. One policy
is for every speed and amplitude within bounds, and both may change while it runs.
"""

import casadi as ca
import numpy as np

import capsyn

RESISTANCE, INDUCTANCE, SUPPLY = 1.0, 5e-3, 48.0  # ohm, H, V


def dynamics(x, u, w):
    """Return the rates of the current [A/s] and of the angle [rad/s]."""
    return [(u[0] - RESISTANCE * x[0]) / INDUCTANCE, w[0]]


def law(x, w):
    """Return the voltage that would keep the current on the reference [V]."""
    along = RESISTANCE * ca.sin(x[1]) + INDUCTANCE * w[0] * ca.cos(x[1])
    return w[1] * along


def problem():
    """Return the problem: the cost is the error of the current at the horizon's end."""
    return capsyn.Problem(
        name="sine",
        dynamics=dynamics,
        domain=capsyn.Box(
            [-12, 0],
            [12, 2 * np.pi],
            names=["current", "angle"],
            units=["A", "rad"],
            periodic=[False, True],
        ),
        exogenous=capsyn.Box([0, 0], [400, 10], names=["speed", "amplitude"], units=["rad/s", "A"]),
        alphabet=capsyn.Alphabet(
            [-SUPPLY, 0, SUPPLY], names=["minus", "zero", "plus"], inputs=["voltage"], units=["V"]
        ),
        default=law,
        horizon=2e-4,
        terminal_cost=lambda x, w: (x[0] - w[1] * ca.sin(x[1])) ** 2,
        settings=capsyn.SsacSettings(rule="steepest", control_weight=2.0, sample_time=5e-5),
        outside="nearest",
    )


def errors(controller, told, **plant):
    """Return the errors of the current [A] after the first 5 of 80 ms, and the switches."""
    run = capsyn.simulate(controller, [0.0, 0.0], duration=0.08, exogenous=told, **plant)
    error = run.states[:, 0] - run.exogenous[:, 1] * np.sin(run.states[:, 1])
    return error[100:], run.switches


if __name__ == "__main__":
    policy = capsyn.synthesize(problem(), leaves="affine", partitions=(8, 12, 4, 4), max_level=0)
    for speed in (100 * np.pi, 50 * np.pi):
        for amplitude in (4.0, 8.0, {0.0: 4.0, 0.04: 8.0}):
            error, switches = errors(policy, {"speed": speed, "amplitude": amplitude})
            print(
                f"{speed:.0f} rad/s, amplitude {amplitude} A: rms error "
                f"{np.sqrt((error**2).mean()):.2f} A, mean {error.mean():+.3f} A, "
                f"{switches} switches"
            )
