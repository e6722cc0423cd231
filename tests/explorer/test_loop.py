"""Programs as JavaScript, and the page's closed loop against `capsyn.simulate`."""

import dataclasses
import warnings

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings

from capsyn import Alphabet, Ball, Box, Problem, SsacSettings, simulate, synthesize
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.explorer.program_javascript import model_javascript, program_javascript
from capsyn.modelling.transcription import transcribe
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Program
from capsyn.programs.texts import JAVASCRIPT
from capsyn.simulation.closed_loop import Holds
from capsyn.simulation.plant import choose_substeps, plant_of
from support.explorer.node import BEGIN, node, texts
from support.exports.policies import built_in
from support.exports.remembering import random_rows
from support.random_programs import random_program
from support.trees import random_policy

LOOP = (
    'import { makeLookup } from "#page/policy/lookup.js";'
    'import { makeLoop } from "#page/loop/loop.js";'
    'import { model } from "./model.js";'
    + BEGIN
    + "const loop = makeLoop(input.policy, makeLookup(input.policy), model);"
)
RUN = LOOP + "print(input.runs.map(({ x0, ...options }) => loop.run(x0, options)));"
SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, 2.5, -2.5, 3.7, 1e-9, -1e200, 1e300, np.inf, -np.inf, np.nan]


def run_programs(directory, programs, states):
    """Return what programs ``x -> y`` give in JavaScript at states (K, n): [(K, outputs), ..]."""
    helpers = "".join(f"const m_{name} = {text};\n" for name, text in JAVASCRIPT.items())
    functions = [program_javascript(p, f"f{k}") for k, p in enumerate(programs)]
    code = BEGIN + helpers + "".join(functions)
    code += f"""
      const functions = [{", ".join(f"f{k}" for k in range(len(programs)))}];
      print(functions.map((f, k) => numbers(input.states).map(x => {{
        const y = new Float64Array(input.sizes[k]);
        f(x, y);
        return Array.from(y, v => String(v).replace("Infinity", "inf"));
      }})));
    """
    sizes = [len(p.results) for p in programs]
    outputs = node(directory, code, random_policy(3), states=texts(states), sizes=sizes)
    return [np.array(rows, dtype=float) for rows in outputs]


def test_every_operation_is_that_of_numpy(tmp_path):
    rng = np.random.default_rng(0)
    pairs = np.stack(np.meshgrid(SPECIAL, SPECIAL), axis=-1).reshape(-1, 2)
    scales = 10.0 ** rng.integers(-8, 3, (4000, 1))
    states = np.concatenate([pairs, rng.normal(size=(4000, 2)) * scales])
    programs = [
        Program(name, (("x", 2),), (("y", 1),), ((name, *range(operation.arity)),), (2,))
        for name, operation in OPERATIONS.items()
    ]
    for program, output in zip(programs, run_programs(tmp_path, programs, states)):
        expected = program.evaluate(states.T)[0].T
        exact = not OPERATIONS[program.name].libm or program.name in ("sqrt", "fabs", "fmod")
        with np.errstate(all="ignore"):
            same = np.isclose(output, expected, rtol=0 if exact else 2e-15, atol=0, equal_nan=True)
        assert same.all(), (program.name, states[~same[:, 0]][:4], output[~same][:4])


ARITHMETIC = tuple(
    name for name, operation in OPERATIONS.items() if not operation.libm or name in ("sqrt", "fabs")
)


def test_random_programs_are_those_of_numpy(tmp_path):
    programs = []

    @settings(max_examples=60, database=None, derandomize=True)
    @given(random_program(ARITHMETIC))
    def collect(program):
        programs.append(program)

    collect()
    states = np.random.default_rng(0).normal(size=(50, 3)) * 3
    for program, output in zip(programs, run_programs(tmp_path, programs, states)):
        np.testing.assert_array_equal(output, program.evaluate(states.T)[0].T)


def test_what_is_no_operation_is_refused():
    program = Program("p", (("x", 1),), (("y", 1),), (("alert(1)", 0),), (1,))
    with pytest.raises(ProblemError, match="known operations; got 'alert"):
        program_javascript(program, "f")


def test_names_in_a_program_do_not_reach_the_source():
    program = Program("</script>", (("new", 1),), (("var", 1),), (("sin", 0),), (1,))
    text = program_javascript(program, "f")
    assert "script" not in text and "new" not in text and "Math.sin(in0[0])" in text


def test_there_is_no_model_in_a_policy_without_one(tmp_path):
    policy = random_policy(3)
    assert model_javascript(policy) == "export const model = null;\n"
    code = 'import { model } from "./model.js";' + BEGIN + "print([model, input.policy.sampled]);"
    assert node(tmp_path, code, policy) == [None, None]


def compare(policy, trajectory, rtol=1e-9, **options):
    """Compare a trajectory of the page with that of `simulate`."""
    expected = simulate(policy, **options)
    last, n = int(expected.last), policy.domain.n
    assert trajectory["ended"] == expected.ended
    assert len(trajectory["t"]) == last + 1
    assert trajectory["switches"] == expected.switches and trajectory["outside"] == expected.outside
    np.testing.assert_array_equal(trajectory["t"], expected.times[: last + 1])
    np.testing.assert_array_equal(trajectory["symbols"], expected.symbols[:last])
    controls = np.reshape(trajectory["u"], (-1, policy.alphabet.m))
    np.testing.assert_array_equal(controls, expected.controls[:last])
    states = np.reshape(np.array(trajectory["x"], dtype=float), (-1, n))
    close = dict(rtol=rtol, atol=rtol)
    np.testing.assert_allclose(states, expected.states[: last + 1], **close)
    np.testing.assert_allclose(trajectory["cost"], expected.costs[: last + 1], **close)
    np.testing.assert_allclose(trajectory["terminalCost"], expected.terminal_cost, **close)
    np.testing.assert_allclose(trajectory["totalCost"], expected.cost, **close)
    arrived = np.nan if trajectory["arrived"] is None else trajectory["arrived"]
    np.testing.assert_equal(arrived, expected.arrived)
    return expected


def assert_runs_agree(directory, policy, runs):
    """Run options in JavaScript's names, and compare each; return the trajectories of Python."""
    names = {"minDwell": "min_dwell", "stopAtTarget": "stop_at_target"}
    names["outsideAtOnce"] = "outside_at_once"
    trajectories = node(directory, RUN, policy, runs=runs)
    return [
        compare(policy, trajectory, **{names.get(key, key): value for key, value in run.items()})
        for run, trajectory in zip(runs, trajectories)
    ]


def test_pendulum_is_that_of_simulate(tmp_path):
    policy = built_in("cart-pendulum")
    assert policy.outside == "nearest"
    starts = policy.domain.sample(12, 3).tolist()
    runs = [{"x0": x0, "duration": 5.0} for x0 in [[3.1, 0.0], *starts]]
    runs += [
        {"x0": [3.1, 0.0], "duration": 5.0, "rate": 100.0},
        {"x0": [3.1, 0.0], "duration": 5.0, "rate": 37.0, "delay": 0.05},
        {"x0": [40.0, 6.0], "duration": 5.0, "rate": 250.0, "delay": 0.0135, "minDwell": 0.05},
        {"x0": [3.1, 0.2], "duration": 5.0, "stopAtTarget": True},
        {"x0": [1.0, 4.9], "duration": 5.0, "outside": "error"},
    ]
    done = assert_runs_agree(tmp_path, policy, runs)
    assert {str(t.ended) for t in done} == {"time", "target", "left the domain"}
    assert any(t.outside > 0 for t in done) and all(t.switches for t in done[:3])


@pytest.mark.parametrize("case", ["a", "b"])
def test_tanks_are_those_of_simulate(case, tmp_path):
    policy = built_in(f"double-tank-{case}")
    x0s = [[0.15, 0.9], [0.02, 0.03], [0.9, 0.55]]
    options = [
        {},
        {"delay": 0.02},
        {"delay": 0.0123, "minDwell": 0.1},
        {"minDwell": 0.0301, "outside": "nearest"},
        {"delay": 0.5, "outside": "nearest"},
        {"delay": 0.3, "outside": 1, "rate": 50.0},
        {"delay": 0.3, "outside": -1, "rate": 200.0},
        {"delay": 1e9, "rate": 20.0},
        {"stopAtTarget": True},
        {"substeps": 3},
        {"x0": [1.2, 0.5], "outside": "nearest"},
        {"x0": [0.5, 1.4], "outside": 0, "delay": 0.004},
        {"x0": [0.5, 1.0 + 1e-9], "outside": "error"},
    ]
    runs = [{"x0": x0, "duration": 5.0, "rate": 1000.0} | more for x0 in x0s for more in options]
    done = assert_runs_agree(tmp_path, policy, runs)
    assert {str(t.ended) for t in done} >= {"time", "target", "left the domain"}
    assert sum(t.outside > 1 for t in done) > 2


def test_cart_pole_and_its_running_cost_are_those_of_simulate(tmp_path):
    policy = dataclasses.replace(built_in("cart-pole"), outside="nearest", min_dwell=0.02)
    runs = [{"x0": x0, "duration": 2.0, "rate": 500.0} for x0 in policy.domain.sample(4).tolist()]
    assert_runs_agree(tmp_path, policy, runs)


def restless(**changes):
    """Return a policy of random rows with a model, which wants another symbol all the time."""
    policy = random_rows()
    width, middle = policy.domain.widths, (policy.domain.lower + policy.domain.upper) / 2
    problem = Problem(
        name="restless",
        dynamics=lambda x, u: [
            2 * (middle[0] - x[0]) + (2 * u[0] - u[1]) * width[0],
            (1 + 0.2 * u[1]) * width[1],  # it goes round
        ],
        domain=policy.domain,
        alphabet=policy.alphabet,
        default=policy.default,
        horizon=1.0,
        running_cost=lambda x: ca.sumsqr(x),
    )
    return dataclasses.replace(policy, model=transcribe(problem), **changes)


@pytest.mark.parametrize("changes", [{"outside": 0}, {"delay": 0.04, "outside": "nearest"}])
def test_what_is_in_force_and_waits_is_that_of_simulate(changes, tmp_path):
    policy = restless(**changes)
    assert policy.remembers and policy.rules.input_holds.any()
    x0s = policy.domain.sample(3, 1).tolist()
    cases = [
        {},
        {"minDwell": 0.02},
        {"minDwell": 0.0, "delay": 0.015},
        {"outside": 0, "outsideAtOnce": True, "rate": 150.0},
        {"delay": 0.0, "rate": 500.0, "outside": "nearest"},
    ]
    runs = [{"x0": x0, "duration": 5.0, "rate": 200.0} | more for x0 in x0s for more in cases]
    done = assert_runs_agree(tmp_path, policy, runs)
    assert sum(int(t.switches) for t in done) > 50 and any(t.outside for t in done)
    held = node(tmp_path, RUN, policy, runs=runs[:1])[0]
    assert_held(policy, held, done[0])


def test_what_is_permitted_is_what_the_reference_permits(tmp_path):
    rng, count = np.random.default_rng(4), 7
    controls = np.array([[0, 0], [0, 1], [1, 0], [1, 1], [2, 0], [0, 0], [0, 1]], dtype=float)
    forbidden = (rng.random((count, count)) < 0.25) & ~np.eye(count, dtype=bool)
    forbidden[3, [1, 6]] = True, False  # of two with the same control the default is not taken
    kinds = np.array([0, 1, 2, 3, 4, 0, 6])  # going from a symbol to its like may cost something
    holds = Holds(np.array([2, 0, 3, 1, 2, 3, 1]), np.array([3, 5]), kinds, forbidden, controls)
    wanted, at_once = rng.integers(0, count, 3000), rng.random(3000) < 0.05
    taken, now, held, inputs = [], None, 0, np.zeros(2, dtype=int)
    for want, once in zip(wanted, at_once):
        label = want
        if now is not None and not once and kinds[want] != kinds[now]:
            (label,) = holds.permitted(*np.array([[now], [want], [held]]), inputs[None])
        first = now is None
        held = 1 if first or kinds[label] != kinds[now] else held + 1
        inputs = np.where(first | (controls[label] != controls[now or 0]), 1, inputs + 1)
        now = label
        taken.append(now if now < count - 1 else -1)
    memory = {"kinds": kinds, "forbidden": forbidden, "holds": holds.symbols / 100}
    memory |= {"input_holds": holds.inputs / 100}
    data = {"controls": controls.tolist(), "slack": 1e-9, "memory": memory}
    data["memory"] = {key: value.tolist() for key, value in memory.items()}
    code = (
        'import { makeHolds } from "#page/loop/holds.js";'
        + BEGIN
        + """
      const holds = makeHolds(input.data, { rate: 100, minDwell: null, outsideAtOnce: true });
      print(input.wanted.map((label, k) => holds.take(label, input.status[k])));
    """
    )
    inputs = {"data": data, "wanted": wanted.tolist(), "status": at_once.astype(int).tolist()}
    assert node(tmp_path, code, random_rows(), **inputs) == taken


def assert_held(policy, told, known):
    """Compare how long symbols and inputs have been held with what a trajectory did."""
    symbols, controls = known.symbols[: known.last], known.controls[: known.last]
    kinds = policy.rules.kinds[symbols]
    for values, held in ((kinds[:, None], told["held"]), (controls, told["heldInputs"])):
        for column, times in zip(values.T, np.reshape(held, values.shape).T):
            starts = np.flatnonzero(np.append(True, column[1:] != column[:-1]))
            since = np.arange(len(column)) - np.maximum.accumulate(
                np.isin(np.arange(len(column)), starts) * np.arange(len(column))
            )
            np.testing.assert_array_equal(times, since + 1)
    assert told["changes"][-1] == known.switches


def escaping():
    """Return a policy whose state runs to infinity in finite time."""
    problem = Problem(
        name="escape",
        dynamics=lambda x, u: [x[0] ** 2 + u[0]],
        domain=Box([0.0], [2.0]),
        alphabet=Alphabet([0.0, 1.0]),
        default=0.0,
        horizon=0.1,
        terminal_cost=lambda x: x[0],
        outside="nearest",
        settings=SsacSettings(steps=4),
        partitions=4,
        max_level=1,
    )
    return synthesize(problem)


def test_an_escape_ends_where_it_ends_in_python(tmp_path):
    policy = escaping()
    run = {"x0": [1.5], "duration": 3.0, "rate": 100.0, "substeps": 2}
    trajectory = node(tmp_path, RUN, policy, runs=[run])[0]
    expected = simulate(policy, **run)
    assert trajectory["ended"] == expected.ended == "not finite"
    assert len(trajectory["t"]) == expected.last + 1


@pytest.mark.parametrize("name", ["cart-pendulum", "double-tank-a", "cart-pole"])
def test_steps_are_chosen_as_in_python(name, tmp_path):
    policy = built_in(name)
    plant = plant_of(policy)
    rates = [10000.0, 1000.0, 480.0, 100.0, 30.0, 10.0, 5.0]
    chosen = node(tmp_path, LOOP + "print(input.rates.map(loop.substeps));", policy, rates=rates)
    for rate, steps in zip(rates, chosen):
        assert_steps(plant, policy, rate, steps)
    assert len({steps["steps"] for steps in chosen}) > 1 or name == "double-tank-a"


def assert_steps(plant, policy, rate, steps):
    """Compare with `choose_substeps`, which warns where the steps do not resolve the dynamics."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", CapsynWarning)
        expected = choose_substeps(plant, policy.controls, np.zeros((0, 1)), 1 / rate)
    assert steps == {"steps": expected, "resolved": not caught}


def test_noise_is_seeded_and_of_the_asked_deviation(tmp_path):
    policy = dataclasses.replace(built_in("cart-pendulum"), target=Ball([0, 0], 0.1))
    code = (
        LOOP
        + """
      const seen = [];
      const lookup = makeLookup(input.policy);
      const spy = { ...lookup, symbol: (x, outside) => {
        seen.push(Array.from(x));
        return lookup.symbol(x, outside);
      } };
      const noisy = makeLoop(input.policy, spy, model);
      const runs = [[1, [0.01, 0.2]], [1, [0.01, 0.2]], [2, [0.01, 0.2]]].map(([seed, noise]) =>
        noisy.run([3, 0], { duration: 20, noise, seed }));
      print({ runs, seen });
    """
    )
    answer = node(tmp_path, code, policy)
    one, again, other = answer["runs"]
    assert one == again and one["x"] != other["x"]
    states = np.reshape(one["x"], (-1, 2))[:-1]
    noise = np.array(answer["seen"][: len(states)]) - states
    np.testing.assert_allclose(noise.std(axis=0), [0.01, 0.2], rtol=0.03)
    assert (abs(noise.mean(axis=0)) < 4 * np.array([0.01, 0.2]) / np.sqrt(len(noise))).all()
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.03
    assert abs(np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]) < 0.03
    assert abs((abs(noise / [0.01, 0.2]) > 2).mean() - 0.0455) < 0.005


def test_wrong_runs_are_refused(tmp_path):
    policy = built_in("cart-pendulum")
    code = (
        LOOP
        + """
      print([{ duration: 0 }, { duration: 1e9 }, { rate: NaN }].map(options => {
        try { loop.run([0, 0], options); } catch (error) { return error.message; }
      }));
    """
    )
    assert all("must be 1 to 10000000" in text for text in node(tmp_path, code, policy))
