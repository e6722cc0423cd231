"""Keep the wanted voltage of a boost converter at any load that a sensor measures.

A sensor at the output gives current over voltage, which is the conductance of the load. The rates
are linear in the conductance, and not in the resistance, so affine leaves fit the conductance well.
The default control is a law: the duty cycle that holds the wanted voltage at rest. The cost is the
square of one combination of both errors, in which one volt counts as a quarter of an ampere. Where
the combination is 0, the converter slides towards its rest.
"""

import numpy as np

import capsyn

SUPPLY, INDUCTANCE, CAPACITANCE = 20.0, 1e-3, 100e-6  # V, H, F


def dynamics(x, u, w):
    """Return the rates of current [A/s] and voltage [V/s]; `u` is 1 while the switch is on."""
    off = 1 - u[0]
    return [(SUPPLY - off * x[1]) / INDUCTANCE, (off * x[0] - w[1] * x[1]) / CAPACITANCE]


def distance(x, w):
    """Return the cost [A^2] of current and voltage for a wanted voltage [V] and a load [S]."""
    at_rest = w[0] ** 2 * w[1] / SUPPLY
    return (x[0] - at_rest + 0.25 * (x[1] - w[0])) ** 2


HORIZON = 1e-4
problem = capsyn.Problem(
    name="measured-load",
    dynamics=dynamics,
    domain=capsyn.Box([0, 20], [20, 60], names=["current", "voltage"], units=["A", "V"]),
    exogenous=capsyn.Box([30, 1 / 40], [50, 1 / 10], names=["wanted", "load"], units=["V", "S"]),
    alphabet=capsyn.Alphabet([0, 1], names=["off", "on"], inputs=["switch"]),
    default=lambda x, w: 1 - SUPPLY / w[0],
    horizon=HORIZON,
    running_cost=lambda x, w: distance(x, w) / HORIZON,
    terminal_cost=distance,
    outside="nearest",
    settings=capsyn.SsacSettings(rule="steepest", steps=4, sample_time=2e-6),
    leaves="affine",
    partitions=(8, 8, 4, 4),
    max_level=2,
)


def offsets(policy, volts, ohms, duration=0.03):
    """Return mean errors of the voltage [V], (V, R), over the last third of runs from 20 V."""
    told = np.array([[volt, 1 / ohm] for volt in volts for ohm in ohms])
    runs = capsyn.simulate(policy, np.tile([0.0, 20.0], (len(told), 1)), duration, exogenous=told)
    voltage = runs.states[..., 1]
    means = voltage[:, -(voltage.shape[1] // 3) :].mean(axis=1) - told[:, 0]
    return means.reshape(len(volts), len(ohms))


if __name__ == "__main__":
    policy = capsyn.synthesize(problem, refine="adaptive", leaf_error=5e-4)
    print(f"{policy.cells.leaf_count:,} cells from {policy.statistics['solves']:,} solves")
    volts, ohms = np.linspace(30, 50, 5), np.linspace(10, 40, 4)
    found = offsets(policy, volts, ohms)
    print("mean voltage less the wanted one [V]")
    print("wanted " + "".join(f"{ohm:8.0f} ohm" for ohm in ohms))
    for volt, row in zip(volts, found):
        print(f"{volt:4.0f} V " + "".join(f"{value:+12.3f}" for value in row))
    steps = {"wanted": {0: 40.0}, "load": {0: 1 / 40, 0.02: 1 / 10}}
    run = capsyn.simulate(policy, [2.0, 40.0], 0.04, exogenous=steps)
    figures = capsyn.tracking(run, "voltage", "wanted", band=0.5)
    print(f"load from 40 to 10 ohm at 20 ms: voltage at least {run.states[5000:, 1].min():.1f} V, "
          f"within 0.5 V after {1000 * figures.settling - 20:.1f} ms")  # fmt: skip
