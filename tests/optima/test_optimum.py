"""The optimum against exact answers, and what it refuses."""

import itertools
import warnings

import numpy as np
import pytest
import scipy.linalg

import capsyn
from capsyn import Alphabet, Ball, Box, Problem, Switching, optimum, problems
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.optima.sweeps import NumpySweeps
from capsyn.optima.task import task_of


def walk(**fields):
    """Return a walk on whole numbers, on which a grid of them is exact."""
    given = {
        "name": "walk",
        "dynamics": lambda x, u: [u[0]],
        "domain": Box([-6], [6]),
        "alphabet": Alphabet([-1.0, 0.0, 1.0], names=["back", "stay", "on"]),
        "default": 0.0,
        "horizon": 1.0,
        "running_cost": lambda x: (x[0] - 1) ** 2,
    }
    return Problem(**given | fields)


def integrator(**fields):
    given = {
        "name": "integrator",
        "dynamics": lambda x, u: [x[1], u[0]],
        "domain": Box([-1, -1], [1, 1]),
        "alphabet": [-1.0, 1.0],
        "default": 0.0,
        "horizon": 1.0,
        "running_cost": lambda x: 1.0,
        "target": Ball([0, 0], 0.01),
    }
    return Problem(**given | fields)


def cheapest(start, samples, switches, held):
    """Return the least cost of all sequences of symbols of the walk."""
    best = np.inf
    for symbols in itertools.product(range(3), repeat=samples):
        x, cost, now, since = float(start), 0.0, -1, 0
        for s in symbols:
            if s != now:
                cost += switches[now, s] if now < 0 or since >= held[now] else np.inf
                now, since = s, 0
            since += 1
            u, y = s - 1.0, x - 1.0
            cost += y**2 + y * u + u**2 / 3  # the integral of (x + u t - 1)^2
            x += u
        best = min(best, cost)
    return best


@pytest.mark.parametrize("backend", ["c", "numpy"])
@pytest.mark.parametrize(
    "switching",
    [
        None,
        Switching(price=0.7),
        Switching(price=0.2, hold=[2.0, 1.0, 3.0]),
        Switching(forbidden=[("back", "on"), ("on", "back"), ("default", "stay")]),
    ],
    ids=["free", "priced", "held", "forbidden"],
)
def test_it_is_the_least_of_all_sequences(switching, backend):
    problem = walk(switching=switching)
    samples = 5
    found = optimum(problem, samples, rate=1, counts=12, starts=[[-3], [1], [2]], backend=backend)
    switches, held = np.zeros((4, 3)), np.ones(3)
    if switching is not None:
        switches = switching.prices(problem.alphabet, problem.default_control)[:, :-1]
        held = np.maximum(switching.holds(problem.alphabet, problem.default_control)[:-1], 1)
    exact = [cheapest(x, samples, switches, held) for x in (-3, 1, 2)]
    assert found.cost(found.starts) == pytest.approx(exact, abs=1e-5)
    assert found.bound and found.values.shape[1:] == (13,)


def test_compiled_and_numpy_sweeps_are_equal():
    problem = problems.plain("cart-pendulum")
    both = [
        optimum(problem, 1.0, rate=50, counts=(31, 20), starts=20, widen=0, backend=backend)
        for backend in ("c", "numpy")
    ]
    assert isinstance(both[1].lookahead.kernel, NumpySweeps)
    assert both[0].values == pytest.approx(both[1].values, rel=1e-6)
    assert both[0].costs == pytest.approx(both[1].costs, rel=1e-6)
    assert both[0].left == both[1].left > 0 and not both[0].bound


def test_threads_do_not_matter():
    one, two = (optimum(integrator(), 3.0, rate=20, counts=40, starts=5, threads=k) for k in (1, 2))
    assert np.array_equal(one.values, two.values)


def test_a_periodic_axis_has_no_seam():
    problem = problems.plain("cart-pendulum")
    found = optimum(problem, 1.0, rate=50, counts=30, starts=5, widen=0)
    assert found.values[0, 0] == pytest.approx(found.values[0, -1], rel=1e-6)
    near = [[1e-9, 1.0], [2 * np.pi - 1e-9, 1.0], [4 * np.pi, 1.0]]
    assert np.ptp(found.cost(near)) < 1e-4 * found.cost(near[0])


def test_double_integrator_in_least_time_switches_on_its_curve():
    counts, rate = 200, 100
    found = optimum(
        integrator(), 6.0, rate=rate, counts=counts, starts=50, widen=1, stop_at_target=True
    )
    x = Box([-1, -1], [1, 1]).sample(4000, 3)
    curve = -x[:, 1] * np.abs(x[:, 1]) / 2
    wrong = found.symbols(x) != (x[:, 0] < curve)
    speeds = np.linspace(-1.5, 1.5, 3001)
    points = np.stack([-speeds * np.abs(speeds) / 2, speeds], axis=1)
    cells = found.box.widths / found.counts
    # the ball ends loops early, by a cell, and a sample is as long
    off = [np.abs((points - one) / cells).max(axis=1).min() for one in x[wrong]]
    assert wrong.mean() < 0.015 and np.median(off) < 1 and max(off) < 2.5
    p, v = np.where(x[:, 0] > curve, 1, -1) * x.T
    least = v + 2 * np.sqrt(np.maximum(p + v**2 / 2, 0))
    assert np.abs(found.cost(x) - least).mean() < 0.02
    assert found.bound and np.isfinite(found.costs).all()


def test_linear_quadratic_costs_are_those_of_riccati():
    symbols = np.linspace(-3, 3, 49)
    problem = integrator(
        domain=Box([-1.5, -2], [1.5, 2]), alphabet=symbols, target=None,
        running_cost=lambda x: x[0] ** 2 + x[1] ** 2,
    )  # fmt: skip
    found = optimum(
        problem, 8.0, rate=20, counts=150, control_weight=1.0, starts=100,
        initial=Box([-1, -1], [1, 1]),
    )  # fmt: skip
    a, b = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    p = scipy.linalg.solve_continuous_are(a, b, np.eye(2), np.eye(1))
    exact = np.einsum("bi,ij,bj->b", found.starts, p, found.starts)
    assert found.mean == pytest.approx(exact.mean(), rel=0.01)
    assert abs(found.grid_error) < 0.01


def test_its_loops_are_those_of_simulate():
    problem = problems.plain("double-tank-b")
    found = optimum(problem, 1.0, rate=50, counts=50, starts=20)
    run = capsyn.simulate(found.control, found.starts, 1.0, 50, model=found.lookahead.task)
    assert run.costs[:, -1] == pytest.approx(found.costs, rel=1e-9)
    again = found.compare(found.control)
    assert again.ratio == pytest.approx(1.0, rel=1e-9) and again.lost == 0


def test_a_policy_is_compared_with_it():
    problem = problems.plain("double-tank-a")
    policy = capsyn.synthesize(problem, max_level=2)
    found = optimum(policy, 4.0, rate=50, counts=100, starts=100)
    compared = found.compare(policy)
    assert 1.05 < compared.low < compared.ratio < compared.high < 1.6
    k = compared.worst
    assert compared.costs[k] - compared.optimal[k] == max(compared.costs - compared.optimal)
    own = found.policy(problem, max_level=3)
    better = found.compare(own)
    assert better.ratio < compared.low
    data = compared.to_json()
    assert data["optimality"] == pytest.approx(1 / compared.ratio)
    assert set(data["worst"]["start"]) == {"x1", "x2"}


def test_prices_count_in_loops_and_policies():
    problem = problems.get("double-tank-b")
    policy = capsyn.synthesize(problem, max_level=2)
    found = optimum(policy, 2.0, rate=50, counts=60, starts=50)
    free = optimum(problems.plain("double-tank-b"), 2.0, rate=50, counts=60, starts=50)
    assert found.switches.mean() < 0.7 * free.switches.mean()
    own = found.compare(found.policy(problem.replace(switching=policy.switching), max_level=3))
    assert 0.99 < own.ratio < found.compare(policy).ratio
    shares = task_of(problem, 50, None, 0.0, False)
    assert shares.switches == pytest.approx(found.lookahead.task.switches)


def test_the_box_is_widened_until_no_loop_leaves():
    problem = problems.get("boost-converter")
    tight = optimum(problem, 2e-3, rate=1e5, counts=60, starts=50, widen=0)
    wide = optimum(problem, 2e-3, rate=1e5, counts=60, starts=50)
    assert tight.left > 0 and not tight.bound
    assert wide.bound and (wide.box.widths >= tight.box.widths).all()
    assert wide.counts[0] > 60 and wide.box.widths[0] / wide.counts[0] == pytest.approx(0.2)


def test_a_coarse_grid_gives_no_bound():
    found = optimum(problems.get("boost-converter"), 2e-3, rate=1e5, counts=3, starts=20, widen=0)
    assert abs(found.grid_error) > 0.1 and not found.bound


def test_exogenous_inputs_are_fixed():
    problem = walk(
        dynamics=lambda x, u, w: [u[0]],
        running_cost=lambda x, w: (x[0] - w[0]) ** 2,
        exogenous=Box([-2], [2], names=["goal"]),
    )
    found = optimum(problem, 5, rate=1, counts=12, starts=[[-3], [1]], exogenous={"goal": 1.0})
    same = optimum(walk(), 5, rate=1, counts=12, starts=[[-3], [1]])
    assert found.costs == pytest.approx(same.costs)
    policy = capsyn.synthesize(problem, max_level=2)
    assert found.compare(policy).ratio >= 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"counts": 5_000_000, "memory": "10MB"}, r"`counts` 5000000 would take .* would fit"),
        ({"counts": 1}, "`counts.*>= 2"),
        ({"duration": 1e9}, "`duration` times `rate` must be 1 to"),
        ({"starts": np.zeros((3, 2))}, r"`starts` must have shape \(B, 1\)"),
        ({"stop_at_target": True}, "`stop_at_target` needs a target"),
        ({"box": Box([0, 0], [1, 1])}, "`box` must be a capsyn.Box of 1 states"),
        ({"exogenous": [1.0]}, "`exogenous` must be left out"),
        ({"problem": walk(delay=0.5)}, "`problem` must have no input delay"),
        ({"problem": walk(switching=Switching(hold={"u1": 3.0}))}, "not of inputs.*'u1'"),
        ({"problem": problems.get("planar-quadrotor")}, "at most 4 states"),
        ({"problem": problems.get("building")}, "`exogenous` must fix what is told|4 states"),
        ({"problem": 3}, "`problem` must be a capsyn.Problem"),
    ],
)
def test_what_cannot_be_used_is_refused_in_a_line(arguments, message):
    given = {"problem": walk(), "duration": 5, "rate": 1} | arguments
    with pytest.raises(ProblemError, match=message) as caught:
        optimum(**given)
    assert "\n" not in str(caught.value)


def test_work_and_memory_are_said_before():
    said = []
    optimum(walk(), 5, rate=1, counts=12, starts=2, progress=said.append)
    assert said == ["12 intervals, 3 symbols: 0.00368 MB, at most 5 sweeps"] or "MB" in said[0]


def test_least_times_that_are_no_whole_samples_are_told():
    problem = problems.plain("double-tank-b").replace(min_dwell=0.05)
    options = {"counts": 20, "starts": 5}
    with pytest.warns(CapsynWarning, match=r"0.05 s is 2.5 samples, and acts as 3"):
        optimum(problem, 1.0, rate=50, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        optimum(problem, 1.0, rate=100, **options)
    policy = capsyn.synthesize(problem, max_level=1)
    with pytest.warns(CapsynWarning, match="is 2.5 samples"):
        capsyn.improve(policy, rate=50, duration=1, starts=20, horizons=[0.2])
