"""Problems: what they accept, and one line for everything that they do not."""

import warnings

import casadi as ca
import numpy as np
import pytest

from capsyn import Alphabet, Ball, Box, Problem, SsacSettings, subdivide, synthesize
from capsyn.errors import ProblemError

FREE = ca.SX.sym("p")
LOOKALIKE = ca.SX.sym("x", 2)


def problem(**changes):
    arguments = {
        "name": "double integrator",
        "dynamics": lambda x, u: [x[1], u[0]],
        "domain": Box([-1, -1], [1, 1]),
        "alphabet": [-1, 1],
        "default": 0,
        "horizon": 1.0,
        "running_cost": lambda x: x[0] ** 2 + x[1] ** 2,
    }
    return Problem(**(arguments | changes))


def raises_two_lines(x, u):
    raise RuntimeError("first line\n  second line")


BAD = [
    ("name", {"name": ""}, "printable string"),
    ("name", {"name": 3}, "got 3"),
    ("domain", {"domain": [[-1, 1], [-1, 1]]}, "must be a capsyn.Box"),
    ("alphabet", {"alphabet": []}, "at least one symbol"),
    ("alphabet", {"alphabet": 5.0}, r"shape \(N, m\); got \(\)"),
    ("alphabet", {"alphabet": [[[1.0]]]}, r"shape \(N, m\); got \(1, 1, 1\)"),
    ("alphabet", {"alphabet": [[1], [1, 2]]}, "must be numbers"),
    ("alphabet", {"alphabet": ["on", "off"]}, "must be numbers"),
    ("alphabet", {"alphabet": [1, 2, 1]}, r"names that tell them apart; got \[1.0\] twice"),
    ("alphabet", {"alphabet": [1, np.nan]}, "finite"),
    ("alphabet", {"alphabet": [1, np.inf]}, "finite"),
    ("alphabet", {"alphabet": range(4097)}, "at most 4096 symbols; got 4097"),
    ("default", {"default": [0, 0]}, r"shape \(1,\), one entry per input; got \(2,\)"),
    ("default", {"default": []}, r"got \(0,\)"),
    ("default", {"default": [[0]]}, r"must be a list of numbers"),
    ("default", {"default": np.nan}, "finite"),
    ("default", {"default": None}, "got"),
    ("default", {"default": "off"}, "must be numbers"),
    ("horizon", {"horizon": 0}, "> 0; got 0"),
    ("horizon", {"horizon": -1.5}, "> 0; got -1.5"),
    ("horizon", {"horizon": np.nan}, "got nan"),
    ("horizon", {"horizon": np.inf}, "got inf"),
    ("horizon", {"horizon": None}, "got None"),
    ("horizon", {"horizon": [1.0]}, r"got \[1.0\]"),
    ("horizon", {"horizon": "long"}, "got 'long'"),
    ("min_dwell", {"min_dwell": -0.1}, ">= 0; got -0.1"),
    ("min_dwell", {"min_dwell": np.nan}, "got nan"),
    ("outside", {"outside": "nowhere"}, "got 'nowhere'"),
    ("outside", {"outside": 2}, "-1 to 1.*got 2"),
    ("outside", {"outside": True}, "got True"),
    ("outside", {"outside": None}, "got None"),
    ("target", {"target": Ball([0.0], 0.1)}, r"2 dimension\(s\), or name .*; got 1"),
    ("target", {"target": Box([0] * 3, [1] * 3)}, r"2 dimension\(s\), or name .*; got 3"),
    ("target", {"target": [0, 0]}, "a Ball, a Box or a function"),
    ("settings", {"settings": {"gamma": -5}}, "capsyn.SsacSettings; got {'gamma': -5}"),
    ("settings", {"settings": None}, "got None"),
    (
        "control_weight",
        {"settings": SsacSettings(control_weight=np.eye(2))},
        r"shape \(1, 1\); got \(2, 2\)",
    ),
    ("partitions", {"partitions": 0}, ">= 1.*got 0"),
    ("partitions", {"partitions": 9.0}, "got 9.0"),
    ("partitions", {"partitions": (3, 3, 3)}, r"2 of them, one per axis; got \(3, 3, 3\)"),
    (r"partitions\[1\]", {"partitions": (3, -3)}, "got -3"),
    ("refinement", {"refinement": 1}, ">= 2.*got 1"),
    ("max_level", {"max_level": -1}, ">= 0 .*got -1"),
    ("max_level", {"max_level": 2.0}, "got 2.0"),
    ("max_level", {"max_level": 30}, "<= 27; got 30"),
    ("leaves", {"leaves": "linear"}, "one of 'constant', 'affine'; got 'linear'"),
    ("leaves", {"leaves": None}, "got None"),
    ("running_cost` and `terminal_cost", {"running_cost": None}, "both be None"),
    ("running_cost", {"running_cost": 3.0}, "must be a function; got 3.0"),
    ("running_cost", {"running_cost": lambda x: x}, r"a scalar; got shape \(2, 1\)"),
    ("running_cost", {"running_cost": lambda x: [x[0], x[1]]}, r"a scalar; got shape \(2, 1\)"),
    ("running_cost", {"running_cost": lambda x: None}, "a scalar; got None"),
    (
        "running_cost",
        {"running_cost": lambda x, u: x[0]},
        "must be a function of x, and of w where there is `exogenous`$",
    ),
    ("running_cost", {"running_cost": lambda x: x[2]}, "failed on symbols with sizes .x: 2.: "),
    ("terminal_cost", {"terminal_cost": lambda x: x.T}, r"a scalar; got shape \(1, 2\)"),
    ("terminal_cost", {"terminal_cost": lambda x: FREE * x[0]}, "undeclared symbol 'p'"),
    ("dynamics", {"dynamics": None}, "must be a function; got None"),
    ("dynamics", {"dynamics": lambda x, u: None}, r"2 component\(s\), one per state; got None"),
    ("dynamics", {"dynamics": lambda x, u: "x[1]"}, r"2 component\(s\).*; got 'x\[1\]'"),
    ("dynamics", {"dynamics": lambda x, u: x[1]}, r"2 component\(s\).*; got shape \(1, 1\)"),
    ("dynamics", {"dynamics": lambda x, u: [x, u]}, r"2 component\(s\).*; got shape \(3, 1\)"),
    ("dynamics", {"dynamics": lambda x, u: []}, r"2 component\(s\).*; got shape \("),
    ("dynamics", {"dynamics": lambda x, u: ca.SX.eye(2)}, r"got shape \(2, 2\)"),
    ("dynamics", {"dynamics": lambda x, u: [x[1], "u"]}, r"2 component\(s\)"),
    ("dynamics", {"dynamics": lambda x, u: [x[1], ca.MX.sym("q")]}, r"2 component\(s\)"),
    ("dynamics", {"dynamics": lambda x, u: [x[1], u[1]]}, r"x: 2, u: 1\): an index is out"),
    ("dynamics", {"dynamics": lambda x, u: [x["a"], u[0]]}, "indexed by numbers"),
    ("dynamics", {"dynamics": lambda x, u: [x[2], u[0]]}, "failed on symbols with .*x: 2, u: 1"),
    ("dynamics", {"dynamics": lambda x: [x[1], x[0]]}, "failed on symbols"),
    ("dynamics", {"dynamics": lambda x, u: [x[1], FREE]}, "undeclared symbol 'p'"),
    ("dynamics", {"dynamics": lambda x, u: [LOOKALIKE[1], u[0]]}, "undeclared symbol 'x_1'"),
    ("dynamics", {"dynamics": lambda x, u: [x[1], 1 / 0]}, "failed .*division by zero"),
    ("dynamics", {"dynamics": raises_two_lines}, "failed .*first line second line"),
    (
        "dynamics",
        {"dynamics": lambda x, u: [x[1] if x[0] > 0 else 0, u[0]]},
        "failed .*neither true nor false",
    ),
]


@pytest.mark.parametrize(("name", "changes", "reason"), BAD)
def test_bad_argument_is_one_line_that_names_it(name, changes, reason):
    with pytest.raises(ProblemError, match=f"^`{name}` .*{reason}") as caught:
        problem(**changes)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 320


@pytest.mark.parametrize("changes", [{"gamma": 1.0}, {"steps": 0}, {"rule": "best"}])
def test_bad_settings_name_the_setting(changes):
    with pytest.raises(ProblemError, match=f"^`{next(iter(changes))}` must be ") as caught:
        problem(settings=SsacSettings(**changes))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "bounds", [([0, 0], [1]), ([0, 0], [1, 0]), ([0, 2], [1, 1]), ([0, np.nan], [1, 1])]
)
def test_bad_bounds_name_lower_or_upper(bounds):
    with pytest.raises(ProblemError, match="^`(lower|upper)` ") as caught:
        problem(domain=Box(*bounds))
    assert "\n" not in str(caught.value)


def test_what_a_user_function_raises_is_kept_as_the_cause():
    with pytest.raises(ProblemError) as caught:
        problem(dynamics=raises_two_lines)
    assert isinstance(caught.value.__cause__, RuntimeError)


def test_constant_nan_in_a_model_is_refused_by_name():
    wrong = problem(dynamics=lambda x, u: [x[1], u[0] * float("nan")])
    with pytest.raises(ProblemError, match="`dynamics` contains the constant NaN"):
        synthesize(wrong)


def test_operation_without_a_c_form_is_refused_by_name():
    wrong = problem(dynamics=lambda x, u: [x[1], u[0] + ca.erfinv(x[0])])
    with pytest.raises(ProblemError, match="^`.*operation") as caught:
        synthesize(wrong)
    assert "\n" not in str(caught.value)


# What is accepted


@pytest.mark.parametrize("alphabet", [[-5, 5], (-5.0, 5.0), [[-5.0], [5.0]], np.array([-5, 5])])
@pytest.mark.parametrize("default", [0, 0.0, [0], (0.0,), np.zeros(1), np.float32(0)])
def test_one_input_accepts_flat_alphabets_and_scalars(alphabet, default):
    accepted = problem(alphabet=alphabet, default=default)
    assert accepted.alphabet == Alphabet([-5.0, 5.0]) and accepted.alphabet.m == 1
    assert accepted.default.shape == (1,) and accepted.default.dtype == float
    assert accepted.default[0] == 0.0


def test_fields_become_plain_values():
    made = problem(partitions=np.array([3, 4]), horizon=np.float32(2), outside="1", refinement=3)
    assert (made.partitions, made.refinement, made.max_level) == ((3, 4), (3, 3), 4)
    assert made.outside == 1 and type(made.horizon) is float
    assert problem(alphabet=[[0, 1], [1, 0]], default=[0.5, 0]).alphabet.m == 2


def test_replace_checks_again():
    made = problem()
    assert made.replace(horizon=2).horizon == 2.0 and made.horizon == 1.0
    with pytest.raises(ProblemError, match="^`horizon`"):
        made.replace(horizon=-2)
    with pytest.raises(ProblemError, match="^`default`"):
        made.replace(alphabet=[[0, 1], [1, 0]])


def evaluate(made, state, control):
    return np.array(made.functions()["dynamics"](state, control)).ravel()


@pytest.mark.parametrize(
    "dynamics",
    [
        lambda x, u: [x[1], 2 * u[0] - x[0]],
        lambda x, u: (x[1], 2 * u[0] - x[0]),
        lambda x, u: np.array([x[1], 2 * u[0] - x[0]]),
        lambda x, u: np.array([[x[1]], [2 * u[0] - x[0]]]),
        lambda x, u: ca.vertcat(x[1], 2 * u[0] - x[0]),
        lambda x, u: ca.horzcat(x[1], 2 * u[0] - x[0]),
        lambda x, u: np.array([[0, 1], [-1, 0]]) @ x + np.array([[0], [2]]) @ u,
        lambda x, u: [x[1], 2 * u - x[0]],
        lambda x, u: ca.SX(np.array([[0, 1], [-1, 0]])) @ x + ca.vertcat(0, 2 * u),
    ],
)
def test_dynamics_may_return_any_kind_of_vector(dynamics):
    made = problem(dynamics=dynamics)
    assert evaluate(made, [0.5, -3.0], 0.25).tolist() == [-3.0, 0.0]


def test_constants_and_single_states_are_accepted():
    made = problem(dynamics=lambda x, u: [1, 0.0], running_cost=lambda x: 2)
    assert evaluate(made, [0, 0], 0).tolist() == [1.0, 0.0]
    assert float(made.functions()["running_cost"]([0, 0])) == 2.0
    assert float(made.functions()["terminal_cost"]([5, 5])) == 0.0
    for dynamics in (lambda x, u: u - x, lambda x, u: [u[0] - x[0]], lambda x, u: u[0] - x[0]):
        made = problem(domain=Box([0], [1]), dynamics=dynamics, running_cost=lambda x: x**2)
        assert evaluate(made, 3.0, 1.0).tolist() == [-2.0]


UFUNCS = {
    **{name: (lambda f: lambda x: f(x[0]))(getattr(np, name)) for name in
       "sin cos tan arcsin arccos arctan sinh cosh tanh arcsinh arctanh exp expm1 log1p sqrt "
       "square abs fabs sign floor ceil negative deg2rad".split()},
    **{name: (lambda f: lambda x: f(x[0], x[1]))(getattr(np, name)) for name in
       "hypot arctan2 maximum minimum fmax fmin power add multiply copysign less".split()},
    "where": lambda x: np.where(x[0] > x[1], x[0] ** 2, np.exp(x[1])),
    "interp": lambda x: np.interp(x[0], [0.0, 0.5, 1.0], [0.1, 0.9, 0.3]),
    "clip": lambda x: np.clip(x[0] * 9, 0.2, 0.7),
    "logical_and": lambda x: np.logical_and(x[0] > 0, x[1] > 0) * x[0],
    "norm": lambda x: np.hypot(np.sin(x[0]), np.sqrt(np.abs(x[1]))),
}  # fmt: skip


@pytest.mark.parametrize("name", UFUNCS)
def test_numpy_functions_work_on_states_without_a_warning(name):
    before = ca.GlobalOptions.getNumpyMode() if hasattr(ca.GlobalOptions, "getNumpyMode") else None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = problem(dynamics=lambda x, u: [UFUNCS[name](x), u[0]], running_cost=UFUNCS[name])
    for state in ([0.3, 0.6], [0.7, 0.1]):
        expected = float(UFUNCS[name](np.array(state)))
        assert np.isclose(evaluate(made, state, 1.0)[0], expected, rtol=1e-14)
        assert np.isclose(float(made.functions()["running_cost"](state)), expected, rtol=1e-14)
    if before is not None:
        assert ca.GlobalOptions.getNumpyMode() == before


@pytest.mark.skipif(
    not hasattr(ca.GlobalOptions, "setNumpyMode"), reason="CasADi before 3.8 has one NumPy mode"
)
@pytest.mark.parametrize("mode", [-1, 0, 1])
@pytest.mark.parametrize("dynamics", [lambda x, u: [np.sin(x[1]), u[0]], raises_two_lines])
def test_casadis_numpy_mode_is_put_back(mode, dynamics):
    before = ca.GlobalOptions.getNumpyMode()
    try:
        ca.GlobalOptions.setNumpyMode(mode)
        try:
            problem(dynamics=dynamics)
        except ProblemError:
            assert dynamics is raises_two_lines
        assert ca.GlobalOptions.getNumpyMode() == mode
    finally:
        ca.GlobalOptions.setNumpyMode(before)


def test_max_level_that_does_not_fit_is_found_before_any_work(monkeypatch):
    monkeypatch.setattr("capsyn.subdivision.limits.available_memory", lambda: 10**7)
    made = problem(max_level=20)  # the grid alone is possible; only a synthesis needs memory
    with pytest.raises(ProblemError, match=r"^`max_level` 20 .* max_level <= \d fits"):
        subdivide(lambda x: x / 0, made.domain, 2, max_level=made.max_level)
    with pytest.raises(ProblemError, match=r"^`max_level` 20 .* max_level <= \d fits"):
        synthesize(made)


def test_the_grid_of_another_space_follows_unless_it_was_given_for_each_axis():
    fewer = problem(partitions=4, refinement=3)
    line = {"domain": Box([0], [1]), "running_cost": lambda x: x[0] ** 2}
    made = fewer.replace(**line, dynamics=lambda x, u: [u[0]])
    assert (made.partitions, made.refinement) == ((4,), (3,))
    with pytest.raises(ProblemError, match="`partitions` must be .* 1 of them"):
        problem(partitions=(4, 5)).replace(**line, dynamics=lambda x, u: [u[0]])
