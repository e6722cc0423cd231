"""Cool two rooms to a setpoint that people change.

The controller is told the wanted temperature and the weather. The built-in problem `building` has
one compressor with two stages, which keeps a stage for 5 min at least. A valve sends half of the
cold to the second room.
"""

import numpy as np

import capsyn
from capsyn import problems

DAY = 24 * 60.0  # min


def offsets(policy, count=100, seed=0):
    """Return the first room's mean errors (count,) over the second day [K].

    Each run has a random start, setpoint and outdoor temperature.
    """
    rng = np.random.default_rng(seed)
    problem = problems.get("building")
    starts, told = (
        rng.uniform(box.lower, box.upper, (count, box.n))
        for box in (problem.domain, problem.exogenous)
    )
    runs = capsyn.simulate(policy, starts, 2 * DAY, exogenous=told)
    return runs.states[:, -int(DAY) :, 0].mean(axis=1) - told[:, 0]


if __name__ == "__main__":
    problem = problems.get("building")
    policy = capsyn.synthesize(problem)
    print(f"law as default: mean error at most {np.abs(offsets(policy)).max():.2f} K")
    constant = capsyn.synthesize(problem.replace(default=[0.5, 0.5]))
    print(f"constant default: at most {np.abs(offsets(constant)).max():.2f} K")
    day = {"setpoint": {0: 24.0, 8 * 60: 21.5, 18 * 60: 24.0}, "outdoor": 34.0}
    run = capsyn.simulate(policy, [24.0, 24.0], DAY, exogenous=day)
    found = capsyn.tracking(run, "T1", "setpoint", band=0.3)
    print(f"a day, set back at night: rms error {found.rms:.2f} K, within 0.3 K after at most "
          f"{found.settling:.0f} min, {run.switches} switches")  # fmt: skip
