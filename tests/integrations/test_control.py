"""Policies and plants as systems of python-control."""

import numpy as np
import pytest

from capsyn import problems, simulate, synthesize
from capsyn.errors import OutsideDomainError, ProblemError

control = pytest.importorskip("control")
from capsyn.integrations.control import plant_system, policy_system  # noqa: E402
from support.closed_loops import two_inputs  # noqa: E402


def closed_loop(model, policy, dt, **options):
    systems = [plant_system(model, dt, **options), policy_system(policy, dt)]
    seen = [*policy.domain.names, *policy.alphabet.inputs]
    return control.interconnect(systems, inputs=[], outputs=seen)


@pytest.mark.parametrize("name", ["cart-pendulum", "double-tank-a"])
def test_a_sampled_loop_is_a_simulation(name):
    problem = problems.plain(name)
    policy = synthesize(problem, max_level=2, outside="nearest", min_dwell=0.0)
    dt, samples = 0.01, 200
    x0 = problem.domain.sample(1, 5)[0]
    run = simulate(policy, x0, samples * dt, 1 / dt)
    times = np.arange(samples + 1) * dt
    for model in (problem, policy):
        loop = closed_loop(model, policy, dt)
        found = control.input_output_response(loop, times, 0, x0)
        n = problem.domain.n
        np.testing.assert_allclose(found.outputs[:n].T, run.states, rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(found.outputs[n:, :-1].T, run.controls)


@pytest.mark.parametrize("outside", [0, "nearest"])
def test_a_policy_that_remembers_has_states(outside):
    problem = two_inputs(outside=outside)
    policy = synthesize(problem)
    dt, samples = 0.01, 300
    system = policy_system(policy, dt)
    assert system.state_labels == ["in_force", "held", "held_x", "held_y"]
    switches = []
    for x0 in ([0.5, 1.0], [0.7, 1.4]):  # the second leaves the domain
        run = simulate(policy, x0, samples * dt, 1 / dt)
        found = control.input_output_response(
            closed_loop(problem, policy, dt), np.arange(samples + 1) * dt, 0, [*x0, 0, 0, 0, 0]
        )
        np.testing.assert_allclose(found.outputs[:2].T, run.states, rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(found.outputs[2:, :-1].T, run.controls)
        switches.append(run.switches)
    assert switches[0] > 5 and run.outside > 0


def test_a_plant_in_continuous_time():
    problem = problems.plain("cart-pendulum")
    times = np.linspace(0, 1, 101)
    found = control.input_output_response(
        plant_system(problem), times, np.full((1, 101), 5.0), [3.0, 0.0],
        solve_ivp_kwargs={"rtol": 1e-10, "atol": 1e-12},
    )  # fmt: skip
    held = simulate(lambda t, x: np.full((len(x), 1), 5.0), [3.0, 0.0], 1.0, 100.0, model=problem)
    np.testing.assert_allclose(found.outputs.T, held.states, atol=1e-7)


@pytest.mark.parametrize("compiler", [None, "no-such-compiler"])
def test_names_and_the_rule_outside(compiler, monkeypatch):
    problem = problems.plain("cart-pendulum")
    policy = synthesize(problem, max_level=1, outside="error")
    if compiler:
        monkeypatch.setenv("CC", compiler)
    system = policy_system(policy, name="law")
    assert system.input_labels == list(problem.domain.names) and system.name == "law"
    assert system.output_labels == list(problem.alphabet.inputs) and system.dt == 0
    assert system.output(0, [], [3.0, 1.0]) == policy.control([3.0, 1.0])
    with pytest.raises(OutsideDomainError):
        system.output(0, [], [3.0, 99.0])
    with pytest.raises(ProblemError, match=r"`state` must have shape \(2,\); got \(1,\)"):
        system.output(0, [], [3.0])


def test_bad_arguments_are_named():
    problem = problems.plain("cart-pendulum")
    for call, words in (
        (lambda: policy_system(problem), "`policy` must be a capsyn.Policy"),
        (lambda: plant_system(problem, -1), "`dt` must be a finite number >= 0"),
        (lambda: plant_system(problem, 0.1, substeps=0), "`substeps` must be a whole number"),
        (lambda: plant_system(problem, substeps=2), "with a sample time `dt` only"),
        (lambda: plant_system(3), "`model` must be"),
        (lambda: plant_system(problem.replace(delay=0.1)), "must have no delay, .*; got 0.1 s"),
        (lambda: policy_system(synthesize(two_inputs(), max_level=0)), "`dt` must be above 0"),
    ):
        with pytest.raises(ProblemError, match=words):
            call()
