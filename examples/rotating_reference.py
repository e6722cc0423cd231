"""Let a current follow a sine whose speed and amplitude are told to the controller.

A bridge puts -48, 0 or 48 V on a coil. The reference is ``amplitude * sin(angle)``. The angle is a
state, and its rate is the speed that the controller is told, so the controller knows where the
reference goes next. One policy serves every speed and amplitude within bounds. Speed and amplitude
may change while the policy runs.
"""

import casadi as ca
import numpy as np

import capsyn

RESISTANCE, INDUCTANCE, SUPPLY = 1.0, 5e-3, 48.0  # ohm, H, V
PERIOD = 5e-5  # s, of a sample


def dynamics(x, u, w):
    """Return the rates of the current [A/s] and of the angle [rad/s]."""
    return [(u[0] - RESISTANCE * x[0]) / INDUCTANCE, w[0]]


def problem():
    """Return the problem, whose cost is the squared error of the current after one sample.

    The prediction lasts one sample, without voltage. The effort of a voltage is the square of the
    current that the voltage adds in this sample. The best symbol is therefore the one after which
    the error is least.
    """
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
        default=0,
        horizon=PERIOD,
        terminal_cost=lambda x, w: (x[0] - w[1] * ca.sin(x[1])) ** 2,
        settings=capsyn.SsacSettings(
            rule="steepest", control_weight=PERIOD / INDUCTANCE**2, sample_time=PERIOD
        ),
        outside="nearest",
        leaves="affine",
        partitions=(1, 36, 1, 8),
        max_level=0,
    )


def tried_out(time, x, w):
    """Return the voltages (B, 1) after which the error is least, by trying all of them online."""
    voltages = np.array([-SUPPLY, 0, SUPPLY])
    stays = np.exp(-RESISTANCE * PERIOD / INDUCTANCE)
    current = stays * x[:, :1] + (1 - stays) * voltages / RESISTANCE
    reference = w[:, 1:] * np.sin(x[:, 1:] + PERIOD * w[:, :1])
    return voltages[np.abs(current - reference).argmin(axis=1)][:, None]


def rms_error(controller, speed, amplitude, **options):
    """Return the root mean square error of the current [A] after the first 5 of 80 ms."""
    told = {"speed": speed, "amplitude": amplitude}
    run = capsyn.simulate(controller, [0.0, 0.0], duration=0.08, exogenous=told, **options)
    error = run.states[:, 0] - run.exogenous[:, 1] * np.sin(run.states[:, 1])
    return np.sqrt((error[100:] ** 2).mean())


if __name__ == "__main__":
    plant = problem()
    policy = capsyn.synthesize(plant)
    for speed in (100 * np.pi, 50 * np.pi):
        for amplitude in (8.0, {0.0: 4.0, 0.04: 8.0}):
            online = rms_error(
                tried_out, speed, amplitude, model=plant, rate=1 / PERIOD, substeps=1
            )
            print(
                f"{speed:.0f} rad/s, amplitude {amplitude} A: rms error "
                f"{rms_error(policy, speed, amplitude):.3f} A, tried out online {online:.3f} A"
            )
