"""From a problem to a policy: the two-symbol law, counts, determinism, systems of one's own."""

import dataclasses
import itertools
import os
import time
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest

from capsyn import Alphabet, Ball, Box, Policy, Problem, SsacSettings, problems, synthesize
from capsyn.errors import CapsynWarning, ProblemError, SynthesisError
from capsyn.modelling.transcription import transcribe, transcribe_target
from capsyn.synthesis import synthesize as module

MU_H, HEAVY = 1.0 * 2.0, 1.0 * 9.81 * 2.0


def factors(states):
    """Return E and theta_dot cos theta: the law is ``u = -5 sign`` of their product."""
    theta, omega = states[..., 0], states[..., 1]
    energy = 0.5 * MU_H * 2.0 * omega**2 + HEAVY * (np.cos(theta) - 1)
    return energy, omega * np.cos(theta)


def law(states):
    """Return the symbols of the bang-bang law; the alphabet is (5, -5)."""
    energy, rate = factors(states)
    return np.where(energy * rate > 0, 1, 0)


def controller_of(problem):
    """Return sSAC as `synthesize` uses it."""
    return module.problem_controller(problem, transcribe(problem))


def states_of(policy, lower, size, offsets):
    """Return the states (M, P, n) at offsets (P, n), in cells, of cells with lower corners."""
    place = (lower[:, None, :] + np.asarray(offsets) * size) / np.array(policy.cells.counts)
    return policy.domain.lower + place * policy.domain.widths


def own(**changes):
    arguments = {
        "name": "own",
        "dynamics": lambda x, u: [u[0]],
        "domain": Box([-1.0], [1.0]),
        "alphabet": [-1, 1],
        "default": 0,
        "horizon": 0.5,
        "running_cost": lambda x: x[0] ** 2,
    }
    return Problem(**(arguments | changes))


@pytest.fixture(scope="module")
def pendulum():
    return synthesize(problems.plain("cart-pendulum"))


@pytest.fixture(scope="module")
def cart_pole():
    return synthesize(problems.plain("cart-pole"))


# The paper's systems


def test_pendulum_cells_with_determined_points_follow_the_law(pendulum):
    offsets = [*itertools.product((0, 1), repeat=2), (0.5, 0.5)]
    checked = 0
    for part in pendulum.cells.leaves():
        points = states_of(pendulum, part.lower, pendulum.cells.sizes(part.level), offsets)
        energy, rate = factors(points)
        determined = ((np.abs(energy) > 1e-6) & (np.abs(rate) > 1e-6)).all(axis=1)
        votes = law(points).sum(axis=1)  # of five points, so there is always a majority
        assert (pendulum.cells.labels_at(part.places) == (votes >= 3))[determined].all()
        if part.level < pendulum.cells.max_level:
            assert np.isin(votes[determined], [0, 5]).all()
        checked += np.count_nonzero(determined)
    assert checked > 1400  # of about 1,700 cells; the others touch a line of ties


def test_pendulum_agrees_with_the_law(pendulum):
    states = pendulum.domain.sample(200_000, 12)
    assert (pendulum(states) == law(states)).mean() >= 0.994


def test_pendulum_takes_few_solves(pendulum):
    statistics = pendulum.statistics
    assert 3000 < statistics["solves"] <= 4700
    assert statistics["worst_case_solves"] == 41_842
    assert statistics["not_finite_points"] == 0 and statistics["solves_by_role"]["others"] == 0


def test_pendulum_cells_above_the_finest_level_are_right_by_area(pendulum):
    axis = (np.arange(64) + 0.5) / 64
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    cells = 0
    for part in pendulum.cells.leaves():
        if part.level < pendulum.cells.max_level:
            points = states_of(pendulum, part.lower, pendulum.cells.sizes(part.level), grid)
            wrong = (law(points) != pendulum.cells.labels_at(part.places)[:, None]).mean(axis=1)
            assert wrong.max() <= 0.01
            cells += len(wrong)
    assert cells > 500


def test_cart_pole_solves_and_agreement(cart_pole):
    assert 46_000 <= cart_pole.statistics["solves"] <= 47_000
    problem = problems.plain("cart-pole")
    states = problem.domain.sample(20_000, 3)
    assert (cart_pole(states) == controller_of(problem).symbols(states)).mean() >= 0.98


@pytest.mark.parametrize("name", ["double-tank-a", "double-tank-b"])
def test_tanks_never_take_the_default(name):
    policy = synthesize(problems.plain(name))
    labels = policy(policy.domain.sample(50_000, 1))
    assert np.unique(labels).tolist() == list(range(len(policy.alphabet)))
    assert policy.volume_shares[-1] == 0.0 and (policy.volume_shares[:-1] > 0.002).all()


@pytest.mark.parametrize("name", ["cart-pendulum", "double-tank-a", "cart-pole"])
def test_sample_is_sane(name):
    sample = synthesize(problems.plain(name), max_level=0).statistics["sample"]
    assert sample["states"] == module.SAMPLES
    assert sample["no_descent"] < 0.01 and sample["indifferent"] < 0.01
    assert sample["not_finite"] == 0.0
    assert 0.1 < sample["reach"] < 100
    if name == "cart-pole":
        assert sample["wanted_over_reachable"] is None  # the steepest rule wants nothing
    else:
        assert 0.1 < sample["wanted_over_reachable"] < 100
    assert sample["effort_over_choice"] == 0.0 or name == "double-tank-a"


@pytest.mark.parametrize("horizon", [0.25, 0.5])
def test_sample_ratios_have_their_exact_values(horizon):
    # J0 = T x^2 and dJ_dlam = 2 T x u with |x| uniform on [0, 1]
    sample = synthesize(own(horizon=horizon, max_level=0)).statistics["sample"]
    assert np.isclose(sample["wanted_over_reachable"], 5 * 0.5 / 2, rtol=0.05)
    assert np.isclose(sample["reach"], 4 * horizon, rtol=0.05)


def test_sample_finds_states_without_descent_and_ties():
    one_way = own(alphabet=[1], horizon=0.1)
    assert abs(synthesize(one_way).statistics["sample"]["no_descent"] - 0.5) < 0.05
    same = own(alphabet=[1, 2], dynamics=lambda x, u: [u[0] ** 2 - 3 * u[0]], max_level=0)
    assert synthesize(same).statistics["sample"]["indifferent"] == 1.0
    heavy = own(settings=SsacSettings(control_weight=1e4), alphabet=[-2, 1], max_level=0)
    assert synthesize(heavy).statistics["sample"]["effort_over_choice"] > 1e3


# Determinism


def file_of(path, problem, **options):
    synthesize(problem, **options).save(path)
    return path.read_bytes()


def test_pendulum_file_is_the_same_for_threads_and_backends(tmp_path):
    problem = problems.plain("cart-pendulum")
    first = file_of(tmp_path / "first.cap", problem, threads=1, backend="c")
    for i, options in enumerate(
        [
            {"threads": 2, "backend": "c"},
            {"threads": 1, "backend": "numpy"},
            {"threads": 2, "backend": "numpy"},
            {"threads": 1, "backend": "auto"},
        ]
    ):
        assert file_of(tmp_path / f"{i}.cap", problem, **options) == first


def test_cart_pole_file_is_the_same_for_threads(tmp_path):
    options = {"max_level": 1, "test_points": "vertices+center+random:1"}
    files = [
        file_of(tmp_path / f"{i}.cap", problems.plain("cart-pole"), threads=i, **options)
        for i in (1, 2, 3)
    ]
    assert files[0] == files[1] == files[2]
    other = file_of(tmp_path / "other.cap", problems.plain("cart-pole"), seed=1, **options)
    assert other != files[0]


def test_threads_are_those_asked_for(monkeypatch):
    pools = []

    class Pool(ThreadPoolExecutor):
        def __init__(self, threads):
            pools.append(threads)
            super().__init__(threads)

    monkeypatch.setattr("capsyn.execution.processors.ThreadPoolExecutor", Pool)
    synthesize(own(), threads=3)
    synthesize(own())
    assert pools == [3, module.processors()]
    assert 1 <= pools[1] <= os.cpu_count()


# What the policy carries


def test_policy_carries_the_problem(pendulum, cart_pole):
    problem = problems.plain("cart-pendulum")
    assert pendulum.name == "cart-pendulum"
    assert pendulum.domain == problem.domain and pendulum.alphabet == problem.alphabet
    assert pendulum.default.tolist() == [0.0] and pendulum.horizon == 1.2
    assert pendulum.outside == "nearest" and pendulum.target == transcribe_target(problem)
    assert pendulum.model == transcribe(problem)
    assert isinstance(pendulum.settings.steps, int) and problem.settings.steps is None
    assert pendulum.settings.gamma == -5.0 and pendulum.settings.control_weight == 0.3
    assert cart_pole.settings == problems.plain("cart-pole").settings
    assert set(pendulum.timings) == {"prepare", "label", "subdivide"}
    assert synthesize(problems.plain("double-tank-b"), max_level=0).target == Ball([0.4, 0.6], 0.05)


def test_overrides_reach_the_policy():
    settings = SsacSettings(rule="steepest", steps=7, control_weight=0.5)
    policy = synthesize(
        problems.plain("cart-pendulum"),
        partitions=(4, 5),
        refinement=(2, 3),
        max_level=2,
        settings=settings,
        outside="-5",
        min_dwell=0.25,
        test_points="vertices+random:2",
        seed=9,
    )
    tree = policy.cells
    assert (tree.partitions, tree.refinement, tree.max_level) == ((4, 5), (2, 3), 2)
    assert policy.settings == dataclasses.replace(settings, sample_time=0.001)  # the problem's
    assert policy.outside == 1 and policy([1.0, 99.0]) == 1
    assert policy.min_dwell == 0.25
    assert policy.statistics["test_points"] == "vertices+random:2"
    assert policy.statistics["seed"] == 9
    zero = synthesize(problems.plain("cart-pole"), max_level=0, min_dwell=0.0, outside="nearest")
    assert zero.cells.max_level == 0 and len(zero.cells.entries) == 4**4


def test_leaves_are_the_problems_own_unless_told():
    constant = problems.plain("cart-pendulum").replace(max_level=1)
    affine = constant.replace(leaves="affine")
    for problem, options, leaves in (
        (constant, {}, "constant"),
        (affine, {}, "affine"),
        (constant, {"leaves": "affine"}, "affine"),
        (affine, {"leaves": "constant"}, "constant"),
    ):
        policy = synthesize(problem, **options)
        assert policy.statistics.get("leaves", "constant") == leaves
        assert (policy.cells.affine is not None) is (leaves == "affine")
    assert synthesize(affine.replace(delay=0.1), leaves="constant").delay == 0.1
    with pytest.raises(ProblemError, match="`leaves` must be constant for a problem with a delay"):
        synthesize(affine.replace(delay=0.1))


def test_settings_change_the_policy(pendulum):
    steepest = synthesize(
        problems.plain("cart-pendulum"), settings=SsacSettings(rule="steepest", control_weight=0.3)
    )
    states = pendulum.domain.sample(5000, 2)
    assert (steepest(states) == law(states)).mean() > 0.99  # two symbols of equal effort
    four = problems.plain("cart-pendulum-4")
    coarse = {"max_level": 2}
    schedule = synthesize(four, **coarse)
    steepest = synthesize(four, settings=SsacSettings(rule="steepest"), **coarse)
    assert (schedule(states) == steepest(states)).mean() < 0.9


def test_max_solves_gives_a_coarser_policy(pendulum):
    policy = synthesize(problems.plain("cart-pendulum"), max_solves=1500)
    assert policy.statistics["stopped_by_max_solves"] and policy.statistics["solves"] <= 1500
    policy.cells.check(3)
    states = pendulum.domain.sample(20_000, 4)
    assert 0.9 < (policy(states) == law(states)).mean() < 0.99


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("max_level", {"max_level": 25, "partitions": 64}),
        ("max_level", {"max_level": -1}),
        ("partitions", {"partitions": 1.5}),
        ("outside", {"outside": "somewhere"}),
        ("min_dwell", {"min_dwell": -1}),
        ("settings", {"settings": {"gamma": -1}}),
        ("test_points", {"test_points": "center"}),
        ("leaves", {"leaves": "linear"}),
        ("max_solves", {"max_solves": 0}),
        ("threads", {"threads": 0}),
        ("threads", {"threads": 1.0}),
        ("seed", {"seed": -1}),
        ("backend", {"backend": "fortran"}),
    ],
)
def test_bad_option_is_found_before_any_work(monkeypatch, name, options):
    monkeypatch.setattr(module, "transcribe", lambda problem: pytest.fail("work was started"))
    with pytest.raises(ProblemError, match=f"^`{name}` ") as caught:
        synthesize(problems.plain("cart-pendulum"), **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("problem", ["cart-pendulum", None, {"name": "mine"}])
def test_what_is_no_problem_is_refused(problem):
    with pytest.raises(ProblemError, match="^`problem` must be a capsyn.Problem; got "):
        synthesize(problem)


# Systems of one's own


def test_one_state_with_an_exact_law():
    policy = synthesize(own(partitions=9, max_level=4))
    states = np.linspace(-1, 1, 4001)[:, None]
    away = np.abs(states[:, 0]) > 1e-9
    assert (policy(states) == (states[:, 0] < 0))[away].all()
    assert policy.statistics["leaves_by_level"] == [8, 2]  # zero becomes a face at level 1


def test_two_inputs_with_an_exact_law():
    problem = own(
        dynamics=lambda x, u: [u[0], 2 * u[1]],
        domain=Box([-1, -2], [1, 2], names=["p", "q"]),
        alphabet=Alphabet(list(itertools.product([-1.0, 1.0], repeat=2)), inputs=["a", "b"]),
        default=[0, 0],
        running_cost=lambda x: x[0] ** 2 + x[1] ** 2,
        settings=SsacSettings(rule="steepest"),
        partitions=(4, 6),
        max_level=3,
    )
    policy = synthesize(problem)
    states = problem.domain.sample(5000)
    assert (policy.control(states) == -np.sign(states)).all()
    assert policy.statistics["leaves_by_level"] == [24]


def test_three_states_agree_with_ssac(tmp_path):
    problem = own(
        dynamics=lambda x, u: ca.vertcat(x[1], x[2], u[0] - 0.5 * np.sin(x[0])),
        domain=Box([-1, -1, -1], [1, 1, 1]),
        alphabet=[-2.0, 0.0, 2.0],
        horizon=1.0,
        running_cost=lambda x: 4 * x[0] ** 2 + 2 * x[1] ** 2 + x[2] ** 2,
        settings=SsacSettings(rule="steepest", control_weight=0.05),
        partitions=(4, 3, 3),
        max_level=3,
        target=Box([-0.1] * 3, [0.1] * 3),
    )
    policy = synthesize(problem)
    states = problem.domain.sample(20_000, 6)
    assert (policy(states) == controller_of(problem).symbols(states)).mean() > 0.97
    assert (policy.volume_shares[:3] > 0.02).all()
    policy.save(tmp_path / "own.cap")
    again = Policy.load(tmp_path / "own.cap")
    assert (again(states) == policy(states)).all() and again.target == problem.target
    assert again.model == policy.model and again.statistics == policy.statistics


def test_no_descent_may_give_the_default(tmp_path):
    one_way = own(alphabet=[2], settings=SsacSettings(on_no_descent="default"), max_level=5)
    policy = synthesize(one_way)
    states = np.linspace(-1, 1, 2001)[:, None]
    expected = np.where(states[:, 0] < 0, 0, -1)
    away = np.abs(states[:, 0]) > 1e-9
    assert (policy(states) == expected)[away].all()
    assert (policy.control(states)[away, 0] == np.where(states[away, 0] < 0, 2.0, 0.0)).all()
    assert np.isclose(policy.volume_shares, 0.5).all()
    policy.save(tmp_path / "own.cap")
    again = Policy.load(tmp_path / "own.cap")
    assert (again(states) == policy(states)).all()
    assert again.settings.on_no_descent == "default"
    best = synthesize(one_way, settings=SsacSettings())
    assert (best(states) == 0).all()


def test_ties_go_to_the_least_effort():
    same = own(
        dynamics=lambda x, u: [ca.sign(u[0]) ** 2],
        alphabet=[3, -1, 2],
        settings=SsacSettings(control_weight=1e-9),
    )
    assert (synthesize(same)(same.domain.sample(100)) == 1).all()
    no_weight = synthesize(same, settings=SsacSettings())
    assert (no_weight(same.domain.sample(100)) == 0).all()  # then the lowest index


# States without a finite result


def broken_at(cost, **changes):
    return own(
        dynamics=lambda x, u: [u[0], -x[1]],
        domain=Box([0, 0], [1, 1]),
        running_cost=cost,
        settings=SsacSettings(rule="steepest", steps=4),
        **changes,
    )


@pytest.mark.parametrize("backend", ["c", "numpy"])
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_few_states_without_a_result_warn_once(backend):
    problem = broken_at(lambda x: ca.log(x[0] + x[1]) ** 2)
    with pytest.warns(CapsynWarning) as caught:
        policy = synthesize(problem, backend=backend)
    assert len(caught) == 1
    assert caught[0].filename == __file__  # it points to the caller
    message = str(caught[0].message)
    assert message.startswith("1 of ") and "at state [0.0, 0.0]" in message
    assert policy.statistics["not_finite_points"] == 1
    assert policy.statistics["not_finite_example"] == [0.0, 0.0]
    policy.cells.check(3)


@pytest.mark.parametrize("backend", ["c", "numpy"])
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_many_states_without_a_result_stop_the_synthesis(backend):
    problem = broken_at(lambda x: ca.sqrt(x[0] - 0.3) + x[1])
    with pytest.raises(SynthesisError, match=r" of 181 solves .* at state \[0\.0, 0\.0\]"):
        synthesize(problem, backend=backend)


@pytest.mark.parametrize("rule", ["schedule", "steepest"])
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_sample_counts_states_without_a_result(rule):
    costs = [lambda x: ca.sqrt(x[0] - 0.25), lambda x: ca.if_else(x[0] < 0.25, np.inf, x[0])]
    for cost in costs:
        problem = broken_at(cost).replace(settings=SsacSettings(rule=rule, steps=4))
        sample = module.sample_statistics(controller_of(problem), problem.domain, 0)
        # u = 0 in the prediction: the first state stays where it is
        assert abs(sample["not_finite"] - 0.25) < 0.05
        assert sample["no_descent"] < 0.01 and sample["reach"] > 0


# Interruption


@pytest.mark.parametrize("threads", [1, 2])
def test_interrupt_is_prompt_and_leaves_no_file(tmp_path, threads):
    def progress(report):
        if report.level == 1:
            raise KeyboardInterrupt

    problem = problems.plain("cart-pole")
    synthesize(problem, max_level=0)  # the kernel is there
    started = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        synthesize(problem, max_level=4, threads=threads, progress=progress).save(
            tmp_path / "p.cap"
        )
    assert time.perf_counter() - started < 0.7  # the whole of it would take 1.5 s or more
    assert not list(tmp_path.iterdir())


def test_progress_reports_every_level():
    reports = []
    policy = synthesize(problems.plain("double-tank-a"), max_level=2, progress=reports.append)
    assert {(r.level, r.max_level) for r in reports} == {(k, 2) for k in range(3)}
    assert reports[-1].total == policy.statistics["solves"]
