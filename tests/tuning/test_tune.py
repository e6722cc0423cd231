"""Free settings found for a goal: what is judged, how a study goes on, what is refused."""

import dataclasses
import sys
from types import SimpleNamespace

import numpy as np
import optuna
import pytest

from capsyn import Box, Free, monte_carlo, problems, simulate, synthesize, tune
from capsyn.errors import ProblemError
from capsyn.tuning.advice import advice
from capsyn.tuning.family import Family
from capsyn.tuning.figures import Charges, Figures, figures_of
from capsyn.tuning.goal import Goal, front
from capsyn.tuning.study import BEGUN, HOST, MOST_BEGUN, OWNER
from capsyn.verification.switching_curve import knee
from capsyn.verification.trials import TrialOptions
from support.problems.block import LOOPS, block

QUICK = {"success": 0.95, "least": "effort", "starts": 40, "fresh": 200, **LOOPS}


@pytest.fixture(scope="module")
def found():
    return tune(block, trials=12, **QUICK)


def test_the_best_meets_the_goal_on_starts_that_no_trial_saw(found):
    assert found.met and found.advice is None and found.figures.success >= 0.95
    assert found.figures.starts == 200 and found.figures.low < found.figures.success
    full = [one for one in found.tried if one.full and one.figures.success >= 0.95]
    assert found.settings in [one.settings for one in full]
    least = min(one.figures.effort for one in full)
    mine = next(one for one in full if one.settings == found.settings)
    assert mine.figures.effort <= 1.2 * least
    first = found.tried[0]
    assert first.settings == {"horizon": Free(0.1, 3).middle, "effort": Free(0.01, 10).middle}
    assert found.figures.effort != mine.figures.effort  # other starts


def test_the_policy_is_that_of_the_settings(found):
    assert found.problem.horizon == found.settings["horizon"]
    states = found.problem.domain.sample(100, 1)
    assert (synthesize(block(**found.settings))(states) == found.policy(states)).all()


def test_hopeless_settings_are_left_after_the_quick_stage(found):
    left = [one for one in found.tried if not one.full]
    assert left and all(one.figures.starts == 20 for one in left)
    full = tune(block, trials=8, quick=False, **QUICK)
    assert all(one.full and one.figures.starts == 40 for one in full.tried)


def test_the_front_has_what_nothing_beats_among_those_that_meet_the_goal(found):
    met = [one for one in found.tried if one.full and found.goal.met(one.figures)]
    assert set(one.number for one in found.front) <= set(one.number for one in met)
    for one in met:
        own = one.figures
        assert any(
            other.figures.effort <= own.effort and other.figures.cost <= own.cost
            for other in found.front
        )


def test_a_study_goes_on_as_if_it_had_never_ended(found, tmp_path):
    storage = tmp_path / "study.journal"
    tune(block, trials=3, storage=storage, **QUICK)
    again = tune(block, trials=12, storage=storage, **QUICK)
    assert [one.to_json() for one in again.tried] == [one.to_json() for one in found.tried]
    assert again.to_json() == found.to_json()
    for changes, said in (
        ({"least": "cost"}, "another goal: success >= 0.95, then least effort; got success"),
        ({"free": {"horizon": Free(0.2, 3)}}, "another ranges: horizon 0.1 to 3; effort"),
        ({"starts": 41}, "another loops"),
        ({"seed": 1}, "another seed: 0; got 1"),
    ):
        with pytest.raises(ProblemError, match=said):
            tune(block, trials=12, storage=storage, **QUICK | changes)
    with pytest.raises(ProblemError, match="another problem"):
        tune(other, trials=12, storage=storage, **QUICK)


def other(horizon=Free(0.1, 3), effort=Free(0.01, 10)):
    return block(horizon, effort).replace(running_cost=lambda x: x[0] ** 2 + x[1] ** 2)


def test_a_goal_that_no_settings_meet_says_what_to_free():
    free = {"control_weight": Free(3, 20)}
    result = tune(block(1.0, 0.1), free, trials=3, success=0.9, starts=40, fresh=50, **LOOPS)
    assert not result.met and result.figures.success < 0.9
    assert "free horizon" in result.advice and "free control_weight" not in result.advice


def test_settings_that_cannot_be_used_are_told():
    free = {"rule": Free(choices=["steepest", "bold"]), "control_weight": Free(0.01, 1)}
    result = tune(block(1.0, 0.1), free, trials=6, least="cost", starts=20, fresh=20, **LOOPS)
    failed = [one for one in result.tried if one.settings["rule"] == "bold"]
    assert failed and all("`rule` must be one of" in one.error for one in failed)
    assert result.settings["rule"] == "steepest"


def test_the_knee_has_the_fewest_switches_at_little_more_than_the_least_cost():
    free = {"price": Free("0.1%", "30%")}
    result = tune(block(1.0, 0.1), free, success=0.9, least="knee", trials=8, **LOOPS)
    full = [one for one in result.tried if one.full]
    least = min(one.figures.cost for one in full)
    near = [one for one in full if one.figures.cost <= 1.03 * least]
    best = next(one for one in full if one.settings == result.settings)
    assert best in near and best.figures.switches == min(one.figures.switches for one in near)
    assert len(full) == 8 and result.goal.axes == ("cost", "switches")


def test_nodes_are_those_of_the_exact_tree():
    free = {"control_weight": Free(0.01, 1)}
    result = tune(block(1.0, 0.1), free, least="nodes", trials=2, starts=20, fresh=20, **LOOPS)
    from capsyn import compress

    assert result.figures.nodes == compress(result.policy).node_count


@pytest.mark.parametrize("backend", ["c", "numpy"])
def test_figures_are_those_of_trials_and_trajectories(backend):
    problem = block(1.0, 0.1)
    policy = synthesize(problem)
    given = {"initial": Box([0.3, 0.3], [0.9, 0.9]), "noise": 0.01, **LOOPS}
    charges = Charges.of(problem, None, lambda u: 3 * abs(u[0]), False)
    options = TrialOptions.of(trials=30, backend=backend, seed=5, **given)
    figures = figures_of(policy, options, charges)
    run = monte_carlo(policy, 30, backend=backend, seed=5, **given)
    assert (figures.success, figures.low, figures.high) == (run.success_rate, run.low, run.high)
    assert figures.switches == pytest.approx(run.switches.sum() / run.times.sum())
    plain = {name: value for name, value in given.items() if name not in ("noise", "initial")}
    options = dataclasses.replace(options, loop=dataclasses.replace(options.loop, noise=None))
    figures = figures_of(policy, options, charges)
    path = simulate(policy, run.initial, **plain, stop_at_target=True)
    cost = np.nanmax(path.costs, axis=1)
    effort = 3 * 0.1 * np.nansum(np.abs(path.controls[..., 0]), axis=1)
    assert figures.cost == pytest.approx(cost.mean())
    assert figures.effort == pytest.approx(effort.mean())


def test_costs_are_the_same_for_all_weights():
    def weighed(speed=Free(0.01, 100)):
        return block(1.0, 0.1).replace(running_cost=lambda x: x[0] ** 2 + speed * x[1] ** 2)

    options = {
        "least": "cost",
        "trials": 2,
        "starts": 20,
        "fresh": 50,
        "backend": "numpy",
        "duration": 2,
        "rate": 10,
    }
    free = tune(weighed, **options)
    own = tune(weighed, cost=lambda x: x[0] ** 2 + x[1] ** 2, **options)
    assert free.settings == own.settings and free.figures == own.figures


def test_a_tail_may_be_fitted():
    free = {"tail": Free(choices=["riccati", "fit"])}
    problem = block(0.5, 0.02).replace(target=None)
    options = {"least": "cost", "trials": 3, "starts": 20, "fresh": 20, "quick": False}
    result = tune(problem, free, **options, **LOOPS)
    assert {one.settings["tail"] for one in result.tried} == {"riccati", "fit"}
    assert all(one.full for one in result.tried) and result.figures.success is None


def figures(success, cost, effort=1.0):
    return Figures(100, success, None, None, cost, effort, 1.0, 0, 9)


def test_successes_come_first_then_what_is_least():
    goal = Goal(0.9, "cost")
    rising = [(0.95, -5), (1.0, 0.5), (0.9, 300.0), (1.0, None), (0.8, 1), (0.8, 2), (0.1, 0)]
    values = [goal.objectives(figures(*one))[0] for one in rising]
    assert values == sorted(values) and len(set(values)) == len(values)
    assert [goal.met(figures(*one)) for one in rising] == [True] * 3 + [False] * 4
    assert [goal.spares(figures(rate, 1)) for rate in (0.9, 0.92, 0.94)] == [False, False, True]
    assert Goal(1.0).spares(figures(1.0, 1)) and Goal(least="cost").spares(figures(0.0, 1))
    assert str(Goal(0.99)) == "success >= 0.99, then least cost"


def test_a_front_ignores_what_is_not_known_and_keeps_one_of_equals():
    points = [
        SimpleNamespace(figures=figures(*one))
        for one in [(1.0, 1, 5), (1.0, 2, 4), (0.9, 2, 5), (1.0, 1, 5), (1.0, 0.5, 6)]
    ]
    axes = ("success", "cost", "effort", "nodes")
    assert front(points, axes) == (points[0], points[1], points[4])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({}, "there is no goal: give `success` as a least share, `least` as one of cost, effort"),
        ({"success": 1.5}, "`success` must be a share in"),
        ({"least": "fuel"}, "`least` must be one of 'cost', 'effort'"),
        ({"least": "cost", "trials": 0}, "`trials` must be a whole number >= 1"),
        ({"least": "cost", "speed": 3}, "there is no argument `speed` of closed loops"),
        ({"least": "cost", "synthesis": {"level": 3}}, "`synthesis` must be arguments of"),
        ({"least": "cost", "hold": 9}, "`hold` must be at most the duration 8"),
        ({"least": "cost", "effort": 3}, "`effort` must be a function"),
        ({"least": "cost", "effort": lambda u: float("nan")}, "`effort` must be a finite number"),
        ({"least": "cost", "cost": lambda x: x}, "`cost` must return a scalar"),
        ({"least": "cost", "storage": "/nowhere/s.db"}, "`storage` cannot be used"),
        ({"least": "cost", "initial": Box([0], [9], names=["v"])}, "`initial` must"),
    ],
)
def test_refusals_before_any_work(arguments, said):
    with pytest.raises(ProblemError, match=said):
        tune(block, **LOOPS | arguments)


def test_nothing_free_no_target_and_a_missing_package(monkeypatch):
    with pytest.raises(ProblemError, match="nothing is free"):
        tune(block(1.0, 1.0), least="cost", **LOOPS)
    aimless = problems.get("cart-pendulum").replace(target=None)
    with pytest.raises(ProblemError, match="`target` must be given"):
        tune(aimless, {"horizon": Free(1, 2)}, success=0.9, duration=1, rate=10)
    monkeypatch.setitem(sys.modules, "optuna", None)
    monkeypatch.delitem(sys.modules, "capsyn.tuning.study", raising=False)
    with pytest.raises(ProblemError, match=r"`tune` needs Optuna: pip install 'capsyn\[tune\]'"):
        tune(block, least="cost", **LOOPS)


def test_what_was_under_way_is_the_first_when_a_study_goes_on(tmp_path, monkeypatch):
    options = {"success": 0.5, "trials": 4, "starts": 40, "fresh": 100} | LOOPS
    whole = tune(block, **options)
    study, seen = {"storage": tmp_path / "study.journal"}, []

    def interrupt(*_):
        raise KeyboardInterrupt

    def stop(text):
        seen.append(text)
        if len(seen) == 3:
            monkeypatch.setattr("capsyn.tuning.tune.figures_of", interrupt)

    with pytest.raises(KeyboardInterrupt):
        tune(block, progress=stop, **options, **study)
    monkeypatch.undo()
    assert tune(block, **options, **study).to_json() == whole.to_json()


def test_a_trial_has_an_owner_from_its_first_moment(tmp_path, monkeypatch):
    """A process that ends as soon as it has asked for settings leaves them to the next."""
    options = {"success": 0.5, "trials": 1, "starts": 20, "fresh": 20} | LOOPS
    study = {"storage": tmp_path / "study.journal"}

    def ends(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("capsyn.tuning.study.Study._try", ends)
    monkeypatch.setattr("capsyn.tuning.study.os.getpid", lambda: 2**22 + 1)  # of no process
    with pytest.raises(KeyboardInterrupt):
        tune(block, **options, **study)
    monkeypatch.undo()
    assert tune(block, **options, **study).to_json() == tune(block, **options).to_json()


def test_lost_loops_come_before_what_is_least_where_no_success_is_asked_for():
    cheap = dataclasses.replace(figures(None, 0.1, 1.0), lost=40)
    goal = Goal(least="cost")
    assert goal.objectives(cheap) > goal.objectives(figures(None, 5.0, 1.0))
    dearer = dataclasses.replace(cheap, cost=9.0, lost=39)
    assert goal.objectives(dearer) < goal.objectives(cheap) and goal.met(cheap)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (None, "what capsyn tune writes"),
        ({"starts": 3}, "what capsyn tune writes"),
        ({"starts": "3"}, "have a starts; got '3'"),
        ({"lost": -1}, "have a lost; got -1"),
        ({"switches": None}, "have a switches; got None"),
        ({"cost": "1"}, "have a cost; got '1'"),
    ],
)
def test_figures_of_a_storage_are_checked(data, said):
    whole = figures(0.5, 1.0, 1.0).to_json()
    assert Figures.from_json(whole) == figures(0.5, 1.0, 1.0)
    more = data if said.startswith("what") else whole | data
    with pytest.raises(ProblemError, match=said):
        Figures.from_json(more)


def test_settings_that_end_their_process_are_given_up(tmp_path):
    """A study does not stop at them whenever it goes on."""
    path = f"sqlite:///{tmp_path}/study.db"
    options = {"storage": path, "starts": 20, "fresh": 20, "success": 0.5} | LOOPS
    tune(block, trials=1, **options)
    dead = optuna.load_study(storage=path, study_name="block").ask()
    dead.set_user_attr(OWNER, f"{HOST} {2**22 + 1}")  # of no process
    dead.set_user_attr(BEGUN, MOST_BEGUN)
    found = tune(block, trials=2, **options)
    assert [one.error for one in found.tried] == [None, "the process ended 2 times on the way"]


def test_a_study_that_others_made_is_refused(tmp_path):
    path = f"sqlite:///{tmp_path}/other.db"
    optuna.create_study(storage=path, study_name="block").ask()
    with pytest.raises(ProblemError, match="that capsyn did not make"):
        tune(block, success=0.5, storage=path, trials=1, **LOOPS)


def test_advice_needs_no_settings_that_the_function_refuses():
    times = Free(0.9, 3)

    def picky(horizon=times):
        if horizon < 1.8:
            raise ProblemError("too short")
        return block(horizon, 0.1)

    told = advice(Family.of(picky), {"horizon": 3}, Goal(0.9))
    assert told == "widen horizon, which is best at its bound 3"
    best = {"horizon": 1, "effort": 1}
    assert "give the problem a tail" in advice(Family.of(block), best, Goal(0.9))


def test_the_knee_is_near_the_least_cost_of_those_that_succeed():
    def point(cost, switches, success):
        return SimpleNamespace(cost=cost, switches=switches, success=success)

    points = [point(1.0, 5, 0.95), point(1.2, 4, 1.0), point(9, 0, 0.91)]
    assert knee(points) is points[1]
    below = [point(-10, 5, 1), point(-9.9, 3, 1), point(3, 1, 1)]
    assert knee(below) is below[1]
