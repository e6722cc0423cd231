"""Improvement by rollouts: better policies, never worse ones, and what is refused."""

import dataclasses
import time

import casadi as ca
import numpy as np
import pytest

import capsyn
from capsyn import Alphabet, Box, Policy, Problem, SsacSettings, Switching, problems
from capsyn.compression.compress import compress
from capsyn.errors import ProblemError
from capsyn.improvement.charged_loop import ChargedLoop
from capsyn.improvement.improve import improve
from capsyn.improvement.judged import Comparison

TANK = Box([0.1, 0.1], [0.9, 0.9], names=["x1", "x2"])


@pytest.fixture(scope="module")
def tank():
    return capsyn.synthesize(problems.plain("double-tank-a"), max_level=3)


@pytest.fixture(scope="module")
def better(tank):
    return improve(tank, 2, rate=50, duration=6, initial=TANK, horizons=[0.5, 0.7], starts=200)


def fresh(policy, given, rate, duration, initial=None, seed=12345, scale=1.0):
    """Return the comparison of a policy with a given one from starts of this seed."""
    samples = round(duration * rate)
    loop = ChargedLoop.of(given, rate, "auto", 2).charging(scale)
    states = given.space.sample(300, seed)
    if initial is not None:
        states = initial.sample(300, seed)
    costs = [
        dataclasses.replace(loop, policy=one).costs_from(states, samples) for one in (given, policy)
    ]
    return Comparison.of(*costs, 0.95)


def test_a_greedy_policy_becomes_better(tank, better):
    """The prototype's figures: 1.26 of the optimum before, 1.01 to 1.02 after a round."""
    assert better.improved and better.rounds[0].kept
    first = better.rounds[0].result
    assert first.high < 0 and first.after < 0.86 * first.before
    assert better.result.after < 0.85 * better.result.before
    other = fresh(better.policy, tank, 50, 6, TANK)
    assert other.high < 0 and other.after < 0.85 * other.before
    run = capsyn.simulate(better.policy, TANK.sample(100, 7), 6, 50)
    assert np.isfinite(run.arrived).all()


def test_the_result_is_a_policy_like_the_given_one(tank, better, tmp_path):
    policy = better.policy
    assert policy.settings.sample_time == 1 / 50 and policy.horizon is None
    for name in ("name", "domain", "alphabet", "outside", "target", "model", "min_dwell"):
        assert getattr(policy, name) is getattr(tank, name)
    assert policy.cells.grid == tank.cells.grid
    told = policy.statistics["improve"]
    assert told["horizon"] == tank.horizon and told["scale"] > 0
    assert [one["round"] for one in told["rounds"]] == list(range(1, 1 + len(told["rounds"])))
    policy.save(tmp_path / "p.cap")
    again = Policy.load(tmp_path / "p.cap")
    assert again.statistics == policy.statistics
    following = improve(again, rate=50, duration=3, initial=TANK, starts=50)
    assert following.rounds[0].horizon in (0.2, 0.35, 0.5, 0.7, 1.0)


def test_the_result_does_not_depend_on_threads_and_little_on_the_backend():
    policy = capsyn.synthesize(random_problem(5), max_level=1)
    options = {"duration": 2, "horizons": 0.5, "starts": 40}
    one = improve(policy, threads=1, **options)
    assert one.improved
    two = improve(policy, threads=3, **options)
    assert np.array_equal(one.policy.cells.entries, two.policy.cells.entries)
    assert one.rounds[0].result == two.rounds[0].result
    three = improve(policy, backend="numpy", **options)
    assert one.rounds[0].result.after == pytest.approx(three.rounds[0].result.after, rel=1e-6)


def test_a_worse_policy_is_never_returned():
    """Rounds end where the cost no longer falls; the policy before that comes back, itself."""
    policy = capsyn.synthesize(problems.plain("double-tank-b"), max_level=1)
    options = {"rate": 50, "duration": 3, "initial": TANK, "starts": 100, "horizons": [0.2, 0.5]}
    best = improve(policy, 4, **options)
    assert len(best.rounds) < 4 and not best.rounds[-1].kept
    assert [one.kept for one in best.rounds[:-1]] == [True] * (len(best.rounds) - 1)
    longer = options | {"horizons": 3.0}  # further than is good, by the rollouts of the other
    same = improve(best.policy, 1, **longer)
    assert same.policy is best.policy and not same.improved
    assert same.result.before == same.result.after
    assert "as given" in repr(same)


def random_problem(seed):
    """Return a random stable-ish nonlinear problem of 1 to 4 states, with some of all features."""
    random = np.random.default_rng(seed)
    n, m = 1 + seed % 4, int(random.integers(1, 3))
    a, b = random.normal(size=(n, n)), random.normal(size=(n, m))
    c = random.normal(size=(n, n))
    symbols = int(random.integers(2, 5))
    told = n < 3 and seed % 5 == 4
    weights = random.uniform(0.2, 2.0, n)
    values = random.uniform(-2, 2, size=(symbols, m))

    def rates(x, u, *w):
        push = [1.0 * w[0][0]] + [0] * (n - 1) if w else [0] * n
        swing = ca.mtimes(c, ca.sin(x)) + ca.mtimes(a - 1.5 * np.eye(n), x)
        return swing + ca.mtimes(b, u) + ca.vertcat(*push)

    ends = random.uniform(0, 2) * (seed % 3 == 0)
    return Problem(
        name=f"random-{seed}",
        dynamics=rates,
        domain=Box(-2 * np.ones(n), 2 * np.ones(n)),
        exogenous=Box([-0.5], [0.5], names=["load"]) if told else None,
        alphabet=Alphabet(values),
        default=np.zeros(m) if seed % 2 else values[0],
        horizon=float(random.uniform(0.3, 1.0)),
        running_cost=lambda x, *w: ca.dot(weights, x**2),
        terminal_cost=(lambda x, *w: ends * ca.sumsqr(x)) if ends else None,
        outside=("nearest", "error")[seed % 2],
        switching=Switching(price="2%", hold=0.1 * (seed % 4 == 0)) if seed % 3 == 1 else None,
        settings=SsacSettings(
            rule=("steepest", "schedule")[seed % 2],
            control_weight=0.1 * (seed % 5),
            sample_time=0.05,
            steps=10,
        ),
        leaves="affine" if n == 3 else "constant",
        partitions=5 if n < 3 else 3,
        max_level=2 if n < 3 else 1,
    )


@pytest.mark.parametrize("seed", [1, 3, 4, 6])
def test_no_harm_to_random_problems(seed):
    policy = capsyn.synthesize(random_problem(seed))
    result = improve(policy, duration=3.0, starts=60, horizons=[0.4, 1.0])
    if result.improved:
        other = fresh(result.policy, policy, 20, 3, scale=result.scale)
        assert not other.low > 0 or other.fewer_lost
        assert other.lost <= other.lost_before + 2
    else:
        assert result.policy is policy


def test_memory_and_forbidden_transitions_are_kept():
    pair = ("(0, 0, 0)", "(1, 1, 1)")
    switching = Switching(price="0.3%", hold=0.1, forbidden=[pair])
    problem = problems.plain("double-tank-a").replace(switching=switching, max_level=2)
    policy = capsyn.synthesize(problem)
    result = improve(policy, rate=50, duration=4, initial=TANK, starts=100)
    assert result.improved and result.policy.remembers
    assert result.policy.switching == policy.switching
    names = problem.alphabet.names
    source, goal = (names.index(name) for name in pair)
    rows = result.policy.transitions[len(names) + 1 :]
    assert len(rows) and not (rows[:, source] == goal).any()
    run = capsyn.simulate(result.policy, TANK.sample(50, 3), 4, 50)
    assert not ((run.symbols[:, :-1] == source) & (run.symbols[:, 1:] == goal)).any()
    changes = np.diff(run.symbols, axis=1) != 0
    assert not (changes[:, 1:] & changes[:, :-1]).any()  # 0.1 s are 5 samples


def test_exogenous_inputs_are_honoured():
    policy = capsyn.synthesize(random_problem(9))
    result = improve(policy, duration=5, starts=100)
    assert result.improved and result.policy.exogenous is policy.exogenous is not None
    assert 0 < result.scale != 1
    other = fresh(result.policy, policy, 20, 5, scale=result.scale)
    assert other.high < 0 and other.after < 0.95 * other.before


def test_effort_counts_as_much_as_is_said():
    policy = capsyn.synthesize(random_problem(9))
    options = {"duration": 3, "starts": 60, "horizons": 0.4}
    dear, free = (improve(policy, scale=scale, **options) for scale in (3.0, 0.0))
    assert (dear.scale, free.scale) == (3.0, 0.0)
    efforts = policy.settings.efforts(policy.alphabet.values)
    means = []
    for one in (dear, free):
        run = capsyn.simulate(one.policy, policy.domain.sample(50, 1), 3, 20, exogenous=[0.1])
        means.append(efforts[run.symbols].mean())
    assert means[0] < 0.8 * means[1]


def test_affine_leaves_stay_affine():
    problem = problems.plain("double-tank-a").replace(leaves="affine", max_level=3)
    policy = capsyn.synthesize(problem)
    result = improve(policy, rate=50, duration=4, initial=TANK, starts=100)
    assert result.improved and result.policy.cells.affine is not None
    assert result.rounds[0].result.after < 0.95 * result.rounds[0].result.before


def test_lost_starts_count_more_than_costs():
    before = np.array([1.0, 2.0, np.inf, 3.0] * 20)
    after = np.array([1.1, 2.1, 2.0, 3.2] * 20)
    spared = Comparison.of(before, after, 0.95)
    assert spared.better and spared.fewer_lost and spared.lost == 0 and spared.low > 0
    assert not Comparison.of(after, before, 0.95).better
    cheaper = Comparison.of(after, 0.9 * after, 0.95)
    assert cheaper.better and cheaper.high < 0
    worst = 0.5 * after
    worst[0] = 7.0
    assert not Comparison.of(after, worst, 0.95).better  # more than twice the worst before
    nothing = Comparison.of(np.full(3, np.inf), np.full(3, np.inf), 0.95)
    assert not nothing.better and nothing.before == np.inf


REFUSED = [
    (lambda p: dataclasses.replace(p, model=None), {}, "`policy` must carry its model"),
    (lambda p: dataclasses.replace(p, delay=0.1), {}, "`policy` must have no input delay"),
    (lambda p: dataclasses.replace(p, settings=None, horizon=None), {}, "`rate` must be given"),
    (lambda p: dataclasses.replace(p, horizon=None), {}, "`horizons` must be given"),
    (lambda p: compress(p), {}, "`policy` must be one of cells"),
    (lambda p: 3, {}, "`policy` must be a capsyn.Policy"),
    (lambda p: p, {"horizons": [0.5, 0.4]}, "`horizons` must ascend"),
    (lambda p: p, {"horizons": 0.02, "rate": 50}, "`horizons` must ascend, from two samples"),
    (lambda p: p, {"rounds": 0}, "`rounds` must be"),
    (lambda p: p, {"starts": 1}, "`starts` must be"),
    (lambda p: p, {"initial": 3}, "`initial` must be a Ball or a Box"),
    (lambda p: p, {"backend": "fortran"}, "`backend` must be"),
    (lambda p: p, {"confidence": 1.0}, "`confidence` must be"),
    (lambda p: p, {"duration": -1}, "`duration` must be"),
]


@pytest.mark.parametrize(("change", "options", "text"), REFUSED)
def test_what_cannot_be_improved_is_told_in_one_line(tank, change, options, text):
    with pytest.raises(ProblemError, match=text) as caught:
        improve(change(tank), **options)
    assert "\n" not in str(caught.value)


def chain(**changes):
    """Return five lags in a row, the last of which is pushed, and a short look ahead."""
    settings = {
        "name": "chain",
        "dynamics": lambda x, u: [x[1] - x[0], x[2] - x[1], x[3] - x[2], x[4] - x[3], u[0]],
        "domain": capsyn.Box([-1] * 5, [1] * 5),
        "alphabet": [-1.0, 0.0, 1.0],
        "default": 0.0,
        "horizon": 2.0,
        "running_cost": lambda x: x[0] ** 2,
        "outside": "nearest",
        "settings": capsyn.SsacSettings(rule="steepest", sample_time=0.1, steps=8),
        "partitions": 1,
        "max_level": 0,
        "leaves": "affine",
    }
    return capsyn.Problem(**settings | changes)


def test_beyond_four_states_it_goes_by_tails():
    policy, said = capsyn.synthesize(chain()), []
    options = {"starts": 100, "duration": 15, "horizons": 1.0}
    result = improve(policy, **options, progress=said.append)
    assert result.improved and result.rounds[0].fitted and result.scale == 1
    assert result.result.after < 0.8 * result.result.before and result.result.high < 0
    assert "tail fitted, round 1" in said and result.to_json()["rounds"][0]["fitted"]
    assert result.policy.horizon == result.rounds[0].horizon < policy.horizon


def test_beyond_four_states_the_controller_is_needed():
    policy = capsyn.synthesize(chain())
    with pytest.raises(ProblemError, match="`policy` must carry its controller .*beyond 4 states"):
        improve(dataclasses.replace(policy, settings=None), rate=10, horizons=1.0)
    with pytest.raises(ProblemError, match="`tail` needs a `running_cost`"):
        improve(capsyn.synthesize(chain(running_cost=None, terminal_cost=lambda x: x[0] ** 2)))


@pytest.mark.parametrize("threads", [1, 2])
def test_an_interrupt_is_prompt(tank, threads):
    improve(tank, rate=50, duration=1, starts=10, max_level=0)  # the kernel is there
    began = time.perf_counter()

    def progress(text):
        assert text.startswith("round 1, horizon 0.2 s: level ")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        improve(tank, rate=1000, threads=threads, progress=progress)
    assert time.perf_counter() - began < 2.0
