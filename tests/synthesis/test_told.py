"""What is told exogenous inputs decides as what knows them, or has them for states, would."""

import dataclasses
import functools

import casadi as ca
import numpy as np
import pytest

from capsyn import (
    Policy,
    SsacSettings,
    Switching,
    agreement,
    compress,
    online_controller,
    subdivide,
    synthesize,
)
from capsyn.errors import ProblemError
from capsyn.modelling.transcription import transcribe
from capsyn.sources.callables import problem_policy
from capsyn.sources.finite_control_set import finite_control_set
from capsyn.synthesis.synthesize import priced, problem_controller
from support.backends import backends
from support.told import ROOMS, fixed, rates, smuggled

TOLD = [[20.0, 38.0], [21.234, 33.3]]
NAMED = dataclasses.replace(ROOMS.alphabet, names=["off", "low", "both", "high", "all"])
PAID = Switching(price=0.05, hold={"low": 3.0}, forbidden=[("high", "low")])
VARIANTS = {
    "plain": {},
    "schedule": {"settings": SsacSettings(gamma=-2.0, control_weight=0.02, steps=4)},
    "to default": {
        "settings": dataclasses.replace(ROOMS.settings, on_no_descent="default"),
    },
    "terminal": {"terminal_cost": lambda x, w: 3 * (x[1] - w[0]) ** 2},
    "law": {"default": lambda x, w: [ca.fmin(ca.fmax(x[0] - w[0], 0), 2), 0.5]},
    "prices": {"alphabet": NAMED, "switching": PAID},
    "a share": {"alphabet": NAMED, "switching": Switching(price="20%")},
    "delay": {"delay": 2.0},
    "prices, delay": {"alphabet": NAMED, "switching": PAID, "delay": 2.0},
    "law, prices": {
        "alphabet": NAMED,
        "switching": PAID,
        "default": lambda x, w: [ca.fmin(ca.fmax(x[0] - w[0], 0), 2), 0.5],
    },
}


def controller(problem, backend="auto"):
    return problem_controller(problem, transcribe(problem), backend)


@backends
@pytest.mark.parametrize(
    ("case", "precision"), [*((case, "double") for case in VARIANTS), ("law", "single")]
)
def test_masks_are_those_of_the_problem_that_knows_them(case, precision, backend):
    problem = ROOMS.replace(**VARIANTS[case])
    settings = dataclasses.replace(problem.settings, precision=precision)
    problem = problem.replace(settings=settings)
    switching, told = priced(problem, transcribe(problem), backend)
    x = problem.domain.sample(300, 1)
    for w in TOLD:
        knows = controller(fixed(problem, w, switching=switching), backend)
        z = np.hstack([x, np.tile(w, (300, 1))])
        masks, known = told.masks(z), knows.masks(x)
        assert masks.shape == known.shape
        limit = 1.0 if precision == "double" else 0.98  # of states; rounding moves some ties
        assert (masks == known).reshape(300, -1).all(axis=1).mean() >= limit
        found, wanted = told.solve(z), knows.solve(x)
        accuracy = {"rtol": 1e-11 if precision == "double" else 1e-3}
        assert np.allclose(found.cost, wanted.cost, **accuracy)
        margin = (1e-6 if precision == "double" else 10) * 1e-5 * wanted.scales
        assert (np.abs(found.gradients - wanted.gradients) <= margin).all()
        assert np.allclose(found.scales, wanted.scales, **accuracy)


@pytest.mark.parametrize("refine", ["isotropic", "adaptive"])
@pytest.mark.parametrize("leaves", ["constant", "affine"])
@pytest.mark.parametrize("case", ["plain", "prices", "law", "delay"])
def test_labels_are_those_of_states_that_stay(case, leaves, refine):
    if leaves == "affine" and case == "delay":
        pytest.skip("affine leaves have no delay")
    problem = ROOMS.replace(**VARIANTS[case])
    told = synthesize(problem, leaves=leaves, refine=refine)
    other = synthesize(smuggled(problem), leaves=leaves, refine=refine)
    assert told.cells.structure() == other.cells.structure()
    z = told.space.sample(4000, 2)
    ties = controller(smuggled(problem)).masks(z)
    several = (ties & (ties - np.uint64(1))) != 0  # more than one bit
    for current in range(-1, 5 if told.remembers else 0):
        now = several[:, 0] if several.ndim == 2 else several[:, current, 0]
        differ = told(z, current=current) != other(z, current=current)
        assert differ[~now].mean() < 0.002  # cells at ties may have other symbols


def test_cells_have_their_symbols():
    policy = synthesize(ROOMS, partitions=(4, 4, 2, 2))
    x, w = policy.domain.sample(2000, 4), policy.exogenous.sample(2000, 5)
    chosen = controller(ROOMS).symbols(np.hstack([x, w]))
    assert (policy(x, w) == chosen).mean() > 0.75
    assert agreement(policy).share > 0.75


def test_files_and_threads_do_not_matter(tmp_path):
    for threads in (1, 2):
        synthesize(ROOMS, threads=threads).save(tmp_path / f"{threads}.cap")
    one, two = ((tmp_path / f"{threads}.cap").read_bytes() for threads in (1, 2))
    assert one == two
    policy = Policy.load(tmp_path / "1.cap")
    assert policy.exogenous == ROOMS.exogenous and policy.domain == ROOMS.domain
    assert policy.default.tolist() == policy.default_control.tolist() == [0.5, 0.5]


def test_a_run_that_was_checkpointed_goes_on(tmp_path):
    first = synthesize(ROOMS, checkpoint=tmp_path / "kept")
    again = synthesize(ROOMS, checkpoint=tmp_path / "kept")
    z = first.space.sample(1000)
    assert np.array_equal(first(z), again(z))
    wider = dataclasses.replace(ROOMS.exogenous, upper=[25.0, 39.0])
    with pytest.raises(ProblemError, match="checkpoint"):
        synthesize(ROOMS.replace(exogenous=wider), checkpoint=tmp_path / "kept")


PREDICTED = {"depth": 2, "sample_time": 5.0, "steps": 2}


@backends
@pytest.mark.parametrize("case", ["plain", "prices", "prices, delay"])
def test_predictive_control(case, backend):
    problem = ROOMS.replace(terminal_cost=lambda x, w: (x[0] - w[0]) ** 2, **VARIANTS[case])
    told = finite_control_set(problem, backend=backend, **PREDICTED)
    x = problem.domain.sample(50, 3)
    for w in TOLD if backend == "c" else TOLD[:1]:
        knows = finite_control_set(fixed(problem, w), backend=backend, **PREDICTED)
        z = np.hstack([x, np.tile(w, (50, 1))])
        assert np.allclose(told.costs(z), knows.costs(x), rtol=1e-11)
        for current in range(-1, 5 if told.in_force > 1 else 0):
            assert (told(z, current) == knows(x, current)).mean() > 0.99
    policy = problem_policy(told, problem, partitions=2, max_level=0)
    assert policy.exogenous == problem.exogenous and policy.domain == problem.domain
    assert policy.delay == problem.delay and policy.model is not None
    x, w = policy.domain.lower, policy.exogenous.upper  # a test point
    assert policy(x, w) == told(np.hstack([x, w])[None])[0]


def test_functions_label_readings():
    seen = []

    def label(z):
        seen.append(z.shape[1])
        return (z[:, 0] > z[:, 2]).astype(int) * 3

    policy = problem_policy(label, ROOMS.replace(leaves="affine"), max_level=2)
    assert policy.cells.affine is None  # a function's leaves are constant
    assert set(seen) == {4} and policy.exogenous == ROOMS.exogenous
    assert policy([26, 20], [21, 30]) == 3 and policy([20, 20], [24, 30]) == 0
    assert policy([[26, 20], [20, 20]], {"setpoint": [21, 24], "outdoor": 30}).tolist() == [3, 0]
    plain = subdivide(label, ROOMS.space, ROOMS.alphabet, partitions=3, max_level=2)
    z = ROOMS.space.sample(1000)
    assert np.array_equal(plain(z), policy(z, outside="error")) and plain.exogenous is None
    with pytest.raises(ProblemError, match="must be given: setpoint, outdoor"):
        policy([20, 20])
    tree = compress(policy, controller=label, mode="linear", agreement=0.9)
    assert tree.exogenous == ROOMS.exogenous and tree.guarantee.controller == "function"


@functools.cache
def background():
    return synthesize(ROOMS, partitions=4)


AFFINE = ROOMS.replace(
    dynamics=lambda x, u, w: (
        ca.vertcat(*rates(x, [1, 0], w)) - ca.vertcat(0.05 * (u[0] - 1), 0.02 * u[1])
    )
)
SAC = {"method": "sac", "settings": SsacSettings(control_weight=0.1, gamma=-3.0, steps=8)}
ONLINE = {
    "ssac": {},
    "search": {"settings": dataclasses.replace(ROOMS.settings, steps=8, application_time="search")},
    "sac": SAC,
    "a constant": {"default": [1.0, 0.0]},
    "a signal": {"default": lambda t: [min(t / 10, 2.0), 0.5]},
    "a policy": {"default": "policy"},
    "sac around a policy": {**SAC, "default": "policy"},
}


@backends
@pytest.mark.parametrize("case", ONLINE)
def test_online_controllers(case, backend):
    options = {"backend": backend, **ONLINE[case]}
    problem = AFFINE if "sac" in case else ROOMS
    x = problem.domain.sample(60, 6)
    for w in TOLD if backend == "c" else TOLD[:1]:
        both = []
        for source in (problem, fixed(problem, w)):
            own = dict(options)
            if own.get("default") == "policy":
                own["default"] = background() if source is problem else background().at(w)
            both.append(online_controller(source, **own))
        told, knows = both
        assert told.domain == problem.domain and told.exogenous == problem.exogenous
        assert told.space == problem.space and knows.exogenous is None
        found, wanted = told.actions(x, w, time=3.0), knows.actions(x, time=3.0)
        assert np.array_equal(found.symbol, wanted.symbol)
        assert np.allclose(found.cost, wanted.cost, rtol=1e-9)
        for name in ("control", "start", "duration", "base"):
            assert np.allclose(getattr(found, name), getattr(wanted, name), rtol=1e-6)
        z = np.hstack([x, np.tile(w, (60, 1))])
        for controls in (told(3.0, z), told(3.0, x, w), told(3.0, x, np.tile(w, (60, 1)))):
            assert np.array_equal(controls, told(3.0, x, dict(zip(("setpoint", "outdoor"), w))))
        assert np.allclose(told(3.0, x, w), knows(3.0, x), rtol=1e-6)
        assert told(3.0, x[0], w).shape == (2,)


def test_what_online_controllers_are_told():
    controller = online_controller(ROOMS)
    with pytest.raises(ProblemError, match="^`exogenous` must be given: setpoint, outdoor"):
        controller(0.0, [20, 20])
    with pytest.raises(ProblemError, match=r"^`exogenous` must be numbers of shape \(..., 2\)"):
        controller.actions([20, 20], [22])
    with pytest.raises(ProblemError, match="^`exogenous` must be left out"):
        online_controller(fixed(ROOMS, [22, 30])).actions([20, 20], 3.0)
    text = (
        r"^`default` must be a policy of 2 state\(s\) \+ 2 exogenous and 2 input\(s\); got 2 and 2$"
    )
    with pytest.raises(ProblemError, match=text):
        online_controller(ROOMS, default=background().at([22, 30]))
    with pytest.raises(ProblemError, match=r"got 2 \+ 2 exogenous and 2$"):
        online_controller(fixed(ROOMS, [22, 30]), default=background())
    policy = background()
    x = policy.domain.sample(20)
    one, two = online_controller(policy), online_controller(ROOMS.replace(partitions=4))
    assert np.allclose(one(0.0, x, [22, 30]), two(0.0, x, [22, 30]))


@backends
@pytest.mark.parametrize("method", ["ssac", "sac"])
def test_a_default_law_asks_online_controllers_for_another_default(method, backend):
    law = AFFINE.replace(default=lambda x, w: [1.0 + 0 * x[0], 0.5 + 0 * w[0]])
    options = {"method": method, "backend": backend, "settings": SAC["settings"]}
    policy = synthesize(law, partitions=2, max_level=0)
    for source in (law, policy):
        with pytest.raises(ProblemError) as error:
            online_controller(source, **options)
        assert str(error.value).startswith("`default` must be given, a constant or a policy")
        assert "\n" not in str(error.value)
        x, w = policy.domain.sample(50), [22.0, 30.0]
        given = online_controller(source, default=[0.0, 0.0], **options)
        plain = online_controller(AFFINE.replace(default=[0.0, 0.0]), **options)
        assert given.model.prediction is None
        for name in ("cost", "control", "duration", "base"):
            found, wanted = (getattr(one.actions(x, w), name) for one in (given, plain))
            assert np.allclose(found, wanted, rtol=1e-9)
        around = online_controller(source, default=background(), **options)
        plain = online_controller(AFFINE, default=background(), **options)
        assert np.allclose(around(0.0, x, w), plain(0.0, x, w))
