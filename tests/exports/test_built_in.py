"""The built-in problems in C: random steps of each, with prices, times and forbidden."""

import subprocess

import numpy as np
import pytest

from capsyn import Switching, problems, synthesize
from capsyn.exports.plan import Plan
from capsyn.exports.sequence import golden_sequence
from capsyn.modelling.time_unit import to_seconds
from support.exports.c_machines import write
from support.exports.c_plans import made

STEPS = 1000
HOW = {"inverter": {}, "building": {}, "docking": {"partitions": (1, 1, 8, 1, 1, 4, 2)}}
"""How the policies of problems are made that have a grid for affine leaves."""
DRIVER = """
#include <stdio.h>
#include "policy.h"
int main(void)
{
    double x[STATES];
    policy_state state;
    for (long k = 0; fread(x, sizeof(double), STATES, stdin) == STATES; ++k) {
        policy_status status;
        if (k % STEPS == 0) { policy_init(&state); }
        const int16_t symbol = policy_step(&state, x, (uint32_t)(k % STEPS), &status);
        fwrite(&symbol, sizeof symbol, 1, stdout);
    }
    return 0;
}
"""


def held(name):
    """Return a built-in problem with a price, times for each symbol, and a forbidden transition."""
    problem = problems.get(name)
    own, names = problem.switching or Switching(), problem.alphabet.names
    time = problem.settings.sample_time
    acts = (problem.alphabet.values != problem.default_control).any(
        axis=1
    )  # not the safe symbol's control
    last = [symbol for symbol, other in zip(names, acts) if other][-1]
    switching = Switching(
        price=own.price or "1%",
        hold={symbol: 4 * (k % 3 + 1) * time for k, symbol in enumerate(names)},
        forbidden=[(names[0], last)] if len(names) > 2 else (),
    )
    return problem.replace(switching=switching, min_dwell=0.0)


def rule_breaks(labels, plan, period, statuses):
    """Return forbidden transitions and broken holds in runs of labels (S, K), and all switches."""
    rules, before, after = plan.policy.rules, labels[:, :-1], labels[:, 1:]
    waits = ~np.isin(statuses[:, 1:], plan.at_once)
    switched = rules.kinds[after] != rules.kinds[before]
    steps = np.arange(labels.shape[1])
    start = np.zeros_like(labels)
    start[:, 1:] = np.where(switched, steps[1:], 0)
    time = (steps - np.maximum.accumulate(start, axis=1) + 1)[:, :-1]
    least = np.ceil(rules.holds[before] / period - 1e-9)
    forbidden = rules.forbidden[before, after] & waits
    return forbidden.sum(), ((time < least) & switched & waits).sum(), switched.sum()


@pytest.mark.parametrize("name", problems.names())
def test_many_steps_of_each(name, tmp_path):
    problem = held(name)
    n = problem.space.n
    count = 200 if n < 4 else 50
    how = {2: {"max_level": 3}, 4: {"max_level": 0}}.get(n)
    how = how or {"leaves": "affine", "max_level": 1, "max_solves": 6000}
    policy = synthesize(problem, **HOW.get(name, how))
    plan = Plan.of(policy)
    runs = golden_sequence(plan, count, STEPS, seed=5)
    forbidden, broken, switches = rule_breaks(runs.labels, plan, runs.period, runs.statuses)
    assert (forbidden, broken) == (0, 0) and switches > 50 * count
    tick = to_seconds(runs.period, policy.time_unit)
    write(made(plan, name="policy", tick=tick).files, tmp_path)
    (tmp_path / "driver.c").write_text(DRIVER)
    own = [f"-DSTATES={n}", f"-DSTEPS={STEPS}", "-O2", "-o", "driver", "driver.c", "policy.c"]
    subprocess.run(["gcc", *own, "-lm"], cwd=tmp_path, check=True)
    readings = np.ascontiguousarray(runs.readings.reshape(-1, n))
    run = subprocess.run([tmp_path / "driver"], input=readings.tobytes(), stdout=-1, check=True)
    found = np.frombuffer(run.stdout, dtype=np.int16).reshape(count, STEPS)
    assert np.array_equal(found, runs.labels)
