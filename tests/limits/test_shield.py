"""Policies that keep limits: attacked by simulation, with memory, delay, inputs and parameters."""

import json

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.contour import ContourSet
from safetensors import safe_open
from safetensors.numpy import save_file

from capsyn import (
    Box,
    DecisionTree,
    KeepLimits,
    Policy,
    SsacSettings,
    Switching,
    compress,
    explore,
    export,
    improve,
    simulate,
    synthesize,
)
from capsyn.compression.curve import size_curve
from capsyn.compression.proof import prove
from capsyn.errors import CapsynWarning, PolicyFormatError, ProblemError
from capsyn.explorer.facts import facts
from capsyn.plots.policy import plot_policy
from capsyn.policies.report import report
from support.explorer.page import json_of
from support.processes.command_line import capsyn, error_of
from support.proofs.limits import PERIOD, double_integrator, worst_limit

CELLS = KeepLimits(cells=(200, 150))


def attacked(policy, count=20_000, samples=60, **more):
    """Return the share of the space that is kept; no random loop from there breaks a limit."""
    z = policy.space.sample(count, 5)
    rng = np.random.default_rng(6)
    kept = policy.keeps_limits(z)
    if policy.kept.rows.shape[1] > 1:
        every = [policy.keeps_limits(z, current=k) for k in range(len(policy.alphabet))]
        kept = np.all(every, axis=0)
    n = policy.domain.n
    x, w = z[kept, :n], z[kept, n:] if policy.exogenous is not None else None
    assert len(x) > 100
    assert worst_limit(policy, x, samples, w=w, rng=rng, **more).max() <= 1e-9
    return kept.mean()


def test_the_plain_policy_breaks_limits_and_the_kept_one_does_not():
    problem = double_integrator()
    plain, kept = synthesize(problem), synthesize(problem, keep_limits=CELLS)
    share = attacked(kept, 100_000)
    states = kept.domain.sample(20_000, 5)
    states = states[kept.keeps_limits(states)]
    assert (worst_limit(plain, states, 60) > 0.01).mean() > 0.05
    assert share == pytest.approx(kept.statistics["limits"]["of_domain"], abs=0.01)
    assert "limits" in kept.timings and "limits" not in plain.timings
    # where its own symbol may be taken the policy has it
    same = plain(states) == kept(states)
    assert 0.5 < same.mean() < 1


def test_what_is_not_kept_is_broken_least():
    kept = synthesize(double_integrator(), keep_limits=CELLS)
    fast = np.array([[0.9, 1.2], [0.95, 1.0], [-1.75, -1.2]])
    assert not kept.keeps_limits(fast).any()
    assert (kept.control(fast)[:, 0] == [-1, -1, 1]).all()


def random_problem(rng):
    """Return a problem of two or three states with random dynamics and limits."""
    n = int(rng.integers(2, 4))
    a, b = rng.normal(0, 1, (n, n)), rng.normal(0, 1.5, n)
    c, bend = rng.normal(0, 1, n), rng.normal(0, 0.4, n)
    kind = rng.integers(3)

    def dynamics(x, u):
        rates = ca.DM(a) @ ca.vertcat(*[x[k] for k in range(n)]) + ca.DM(b) * u[0]
        extra = [bend[k] * (ca.sin(x[k]) if kind == 0 else ca.fabs(x[k])) for k in range(n)]
        return [rates[k] + (extra[k] if kind < 2 else 0.0) for k in range(n)]

    return double_integrator(
        dynamics=dynamics,
        domain=Box([-2.0] * n, [2.0] * n),
        running_cost=lambda x: ca.sumsqr(x - ca.DM(c)),
        limits=lambda x: [x[0] - 1.0, -x[1] - 1.2, ca.sumsqr(x) - 4.5],
        settings=SsacSettings(rule="steepest", steps=8, sample_time=float(rng.uniform(0.05, 0.3))),
        horizon=0.5,
        max_level=2,
        min_dwell=float(rng.choice([0.0, 0.0, 0.4])),
    )


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(12))
def test_random_problems_are_attacked_in_vain(seed):
    problem = random_problem(np.random.default_rng(seed))
    cells = 120 if problem.domain.n == 2 else 36
    kept = synthesize(problem, keep_limits=KeepLimits(cells=cells))
    states = kept.domain.sample(30_000, 7)
    states = states[kept.keeps_limits(states)]
    if len(states):
        assert worst_limit(kept, states, 50).max() <= 1e-9


def test_a_least_time_is_waited_for():
    plain = synthesize(double_integrator(), keep_limits=CELLS)
    slow = synthesize(double_integrator(min_dwell=3 * PERIOD), keep_limits=CELLS)
    assert attacked(slow) < plain.statistics["limits"]["of_domain"]


@pytest.mark.parametrize(
    "more",
    [
        {"switching": Switching(price="3%")},
        {"switching": Switching(price="1%", hold={"-1": 0.3})},
        {"switching": Switching(forbidden=[("-1", "1"), ("1", "-1")])},
        {"delay": 0.04},
        {"delay": 0.1, "switching": Switching(price="1%", hold=0.2)},
    ],
    ids=["price", "hold", "forbidden", "delay", "delay and hold"],
)
def test_symbols_in_force_are_told_apart(more, tmp_path):
    problem = double_integrator(**more)
    kept = synthesize(problem, keep_limits=CELLS)
    assert kept.kept.rows.shape[1] == 4
    assert attacked(kept) > 0.2
    states = kept.domain.sample(5000, 8)
    each = np.array([kept.keeps_limits(states, current=k) for k in range(3)])
    assert (kept.keeps_limits(states, current="default") == kept.keeps_limits(states)).all()
    if "delay" in more:
        assert (each[0] != each[2]).any()  # what is under way matters
    path = tmp_path / "kept.cap"
    kept.save(path)
    again = Policy.load(path)
    for k in range(3):
        assert (again.keeps_limits(states, current=k) == each[k]).all()
        assert (again(states, current=k) == kept(states, current=k)).all()
    tree = compress(kept)
    assert (tree.keeps_limits(states, current=1) == each[1]).all()


def test_exogenous_inputs_stay():
    problem = double_integrator(
        exogenous=Box([0.2], [1.0], names=["wall"]),
        limits=lambda x, w: [x[0] - w[0], -1.8 - x[0], x[1] - 1.4, -1.4 - x[1]],
        running_cost=lambda x, w: (x[0] - w[0]) ** 2 + 0.1 * x[1] ** 2,
        dynamics=lambda x, u, w: [x[1], u[0] - 0.1 * w[0]],
    )
    kept = synthesize(problem, keep_limits=KeepLimits(cells=(80, 60, 8)))
    assert attacked(kept) > 0.2
    x = kept.domain.sample(5000, 9)
    near, far = kept.keeps_limits(x, 0.25), kept.keeps_limits(x, {"wall": 0.95})
    assert (far & ~near).any() and not (near & ~far).any()
    fixed = kept.at(0.25)
    assert (fixed.keeps_limits(x) == near).all()
    assert attacked(fixed) > 0.2


def test_parameters_are_kept_for_throughout_their_ranges():
    def model(x, u, p):
        return [x[1], p[0] * u[0] + p[1]]

    ranges = {"gain": (0.8, 1.3), "slope": (-0.2, 0.1)}
    asked = KeepLimits(cells=(200, 150), model=model, parameters=ranges)
    kept = synthesize(double_integrator(), keep_limits=asked)
    known = synthesize(double_integrator(), keep_limits=CELLS)
    assert kept.statistics["limits"]["share"] < known.statistics["limits"]["share"]
    assert kept.kept.parameters == ranges
    rng = np.random.default_rng(10)
    states = kept.domain.sample(20_000, 5)
    states = states[kept.keeps_limits(states)]
    corners = rng.integers(0, 2, (len(states), 2))
    low, high = np.array(list(ranges.values())).T
    p = (low + corners * (high - low)).T

    def rates(x, u, p):
        return np.stack([x[1], p[0] * u[0] + p[1]])

    assert worst_limit(kept, states, 60, dynamics=rates, parameters=p).max() <= 1e-9
    states = known.domain.sample(20_000, 5)
    states = states[known.keeps_limits(states)]
    p = np.repeat([[0.8], [0.1]], len(states), axis=1)
    assert worst_limit(known, states, 60, dynamics=rates, parameters=p).max() > 0.01


def test_the_default_control_is_taken_where_nothing_descends():
    settings = SsacSettings(
        rule="steepest", steps=16, sample_time=PERIOD, on_no_descent="default", control_weight=0.3
    )
    problem = double_integrator(settings=settings, alphabet=[-1.0, 1.0])
    for change in ({}, {"switching": Switching(price="2%")}):
        kept = synthesize(problem.replace(**change), keep_limits=CELLS)
        assert (kept(kept.domain.sample(20_000)) == -1).any()
        attacked(kept)


def test_a_periodic_state_goes_around():
    problem = double_integrator(
        dynamics=lambda x, u: [1.5 + 0 * u[0], u[0]],
        domain=Box([0.0, -1.5], [4.0, 1.5], periodic=[True, False]),
        limits=lambda x: [(x[0] >= 3.0) * (x[0] < 3.5) * (x[1] + 0.5), -1.4 - x[1], x[1] - 1.4],
        running_cost=lambda x: (x[1] - 1.0) ** 2,
    )
    kept = synthesize(problem, keep_limits=KeepLimits(cells=(157, 61)))
    z = kept.domain.sample(20_000, 5)
    z = z[kept.keeps_limits(z)]
    assert len(z) > 2000 and kept.keeps_limits([[3.99, 0.5], [0.0, 0.5], [4.1, 0.5]]).all()
    for _ in range(120):  # with turns counted
        u = kept.control(z)[:, 0]
        for part in (0.25, 0.5, 0.75, 1.0):
            y = kept.domain.wrap(z + part * PERIOD * np.stack([np.full(len(z), 1.5), u], axis=1))
            assert kept.model.limits.evaluate(y.T)[0].max() <= 1e-9
        z = y


def test_trees_keep_what_their_policy_keeps():
    kept = synthesize(double_integrator(max_level=2), keep_limits=CELLS)
    exact, free = compress(kept), compress(kept, mode="freedom", node_price=5.0)
    for tree in (exact, free):
        assert isinstance(tree, DecisionTree)
        prove(tree, kept)
        attacked(tree)
    assert (exact(kept.domain.sample(5000)) == kept(kept.domain.sample(5000))).all()
    assert free.guarantee.mode == "freedom"
    for options in ({"mode": "linear"}, {"level": 1}, {"judge": "loop"}):
        with pytest.raises(ProblemError, match="`mode` must be exact or freedom"):
            compress(kept, **options)
    with pytest.raises(ProblemError, match="most trees would not"):
        size_curve(kept)
    with pytest.raises(ProblemError, match="not made to keep limits"):
        improve(kept)


def test_affine_leaves_become_constant_ones():
    flat = double_integrator(leaves="affine", max_level=3)
    kept = synthesize(flat, keep_limits=CELLS)
    assert kept.cells.affine is None
    attacked(kept)


def test_loops_at_other_times_are_warned_of():
    kept = synthesize(double_integrator(), keep_limits=CELLS)
    simulate(kept, [0.0, 0.0], 1.0)
    for other in ({"rate": 20}, {"min_dwell": 0.3}):
        with pytest.warns(
            CapsynWarning, match="sampled every 0.1 s, with the policy's least times"
        ):
            simulate(kept, [0.0, 0.0], 1.0, **other)


def test_pages_and_pictures_say_it(tmp_path):
    kept = synthesize(double_integrator(), keep_limits=CELLS)
    sections = {section["title"]: section["rows"] for section in facts(report(kept))}
    ((_, text),) = [row for row in sections["Controller"] if row[0] == "limits"]
    assert text.startswith("kept from") and text.endswith("sampled every 0.1 s")
    ax = plot_policy(kept, ax=plt.figure().gca())
    lines = [c for c in ax.collections if isinstance(c, ContourSet)]
    (paths,) = [line.get_paths() for line in lines]
    edge = np.concatenate([path.vertices for path in paths])
    near = kept.keeps_limits(edge * 0.97)  # a convex set around the origin, roughly
    assert near.mean() > 0.9 and kept.keeps_limits(edge * 1.03).mean() < 0.1
    assert "limits are kept inside" in [t.get_text() for t in ax.get_legend().get_texts()]
    explore(kept, tmp_path / "page.html")
    assert "kept from" in str(json_of((tmp_path / "page.html").read_text(encoding="utf-8")))


PROBLEM = """
from capsyn import Box, Problem, SsacSettings
problem = Problem(
    name="wall",
    dynamics=lambda x, u: [x[1], u[0]],
    domain=Box([-2.0, -1.5], [2.0, 1.5]),
    alphabet=[-1.0, 1.0],
    default=0.0,
    horizon=1.0,
    running_cost=lambda x: (x[0] - 0.9) ** 2,
    settings=SsacSettings(rule="steepest", sample_time=0.1),
    limits=lambda x: [x[0] - 1.0, -1.8 - x[0], x[1] - 1.4, -1.4 - x[1]],
    max_level=2,
)
"""


def test_the_command_line(tmp_path):
    (tmp_path / "wall.py").write_text(PROBLEM)
    made = ["synth", "wall.py", "--keep-limits", "--limit-cells", "200,150", "-o", "wall.cap"]
    out, _ = capsyn(*made, cwd=tmp_path)
    assert "limits" in out and "kept from" in out and "not from others in x1" in out
    data = json.loads(capsyn("info", "wall.cap", "--quick", "--json", cwd=tmp_path)[0])
    assert data["limits"]["steps"] == [200, 150]
    assert data["statistics"]["limits"]["of_domain"] == pytest.approx(data["limits"]["kept_share"])
    out, _ = capsyn("query", "wall.cap", "0.95", "1.0", cwd=tmp_path)
    assert out.endswith("limits are not kept from there\n")
    out, _ = capsyn("query", "wall.cap", "0", "0", "--json", cwd=tmp_path)
    assert json.loads(out)["keeps_limits"] is True
    capsyn("compress", "wall.cap", "-o", "tree.cap", cwd=tmp_path)
    capsyn("info", "tree.cap", "--quick", "--proof", "wall.cap", cwd=tmp_path)
    assert "--limit-cells is for --keep-limits" in error_of(
        "synth", "wall.py", "--limit-cells", "9", "-o", "p.cap", cwd=tmp_path
    )
    assert "takes no --keep-limits" in error_of(
        "synth", "wall.py", "--keep-limits", "--source", "optimum", "-o", "p.cap", cwd=tmp_path
    )
    assert "needs a problem with `limits`" in error_of(
        "synth", "cart-pendulum", "--keep-limits", "-o", "p.cap", cwd=tmp_path
    )


def version(path):
    with safe_open(path, framework="np") as file:
        return json.loads(file.metadata()["capsyn-policy"])["version"]


def test_files_of_both_versions(tmp_path):
    problem = double_integrator(limits=None)
    old, path = synthesize(problem), tmp_path / "p.cap"
    old.save(path)
    assert version(path) == 1
    assert Policy.load(path).kept is None
    with pytest.raises(ProblemError, match="was made with `keep_limits`"):
        old.keeps_limits([0.0, 0.0])
    only = synthesize(double_integrator())
    only.save(path)
    assert version(path) == 12
    assert Policy.load(path).model.limits == only.model.limits
    kept = synthesize(double_integrator(), keep_limits=CELLS)
    kept.save(path)
    first = path.read_bytes()
    again = Policy.load(path)
    again.save(path)
    assert path.read_bytes() == first
    states = kept.domain.sample(5000)
    assert (again.keeps_limits(states) == kept.keeps_limits(states)).all()
    assert again.kept.sample_time == PERIOD and again.kept.parameters == {}
    share = kept.statistics["limits"]["of_domain"]
    assert report(again)["limits"]["kept_share"] == pytest.approx(share)


def test_damaged_sets_in_files_are_refused(tmp_path):
    path = tmp_path / "p.cap"
    synthesize(double_integrator(), keep_limits=CELLS).save(path)
    with safe_open(path, framework="np") as file:
        arrays = {name: file.get_tensor(name) for name in file.keys()}
        metadata = file.metadata()
    changed = dict(arrays, kept_rows=1 - arrays["kept_rows"])
    save_file(changed, path, metadata)
    with pytest.raises(PolicyFormatError, match="checksum"):
        Policy.load(path)
    save_file({k: v for k, v in arrays.items() if k != "kept_rows"}, path, metadata)
    with pytest.raises(PolicyFormatError, match="arrays of a policy"):
        Policy.load(path)


@pytest.mark.parametrize(
    ("change", "asked", "message"),
    [
        ({"limits": None}, True, "needs a problem with `limits`"),
        ({}, 3, "`keep_limits` must be True, False or a capsyn.KeepLimits; got 3"),
        ({"delay": 0.2}, True, "a delay of at most the sample time, 0.1 s; got 0.2"),
        ({"switching": Switching(hold={"v": 0.2})}, True, "takes no `hold` of inputs"),
        ({"limits": lambda x: []}, True, "`limits` must return one or more components"),
        ({"limits": 3.0}, True, "`limits` must be a function; got 3.0"),
    ],
)
def test_what_cannot_be_kept_is_refused(change, asked, message):
    from capsyn import Alphabet

    if "switching" in change:
        change = change | {"alphabet": Alphabet([-1.0, 0.0, 1.0], inputs=["v"])}
    with pytest.raises(ProblemError, match=message):
        synthesize(double_integrator(**change), keep_limits=asked)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"parameters": {"a": (1, 2)}}, "need a `model`"),
        ({"model": 3}, "`model` must be a function"),
        ({"model": max, "parameters": {"a": (2, 1)}}, r"pairs \(low, high\); got 2 to 1 for 'a'"),
        ({"model": max, "parameters": {"a": 1.0}}, r"pairs \(low, high\)"),
        ({"model": max, "parameters": 3}, "ranges by name"),
    ],
)
def test_wrong_ranges_are_refused(options, message):
    with pytest.raises(ProblemError, match=message):
        KeepLimits(**options)


def test_wrong_cells_and_times_are_refused(tmp_path):
    with pytest.raises(ProblemError, match="`cells` must"):
        synthesize(double_integrator(), keep_limits=KeepLimits(cells=(4, 5, 6)))
    with pytest.raises(ProblemError, match="is too large"):
        synthesize(double_integrator(), keep_limits=KeepLimits(cells=1_000_000))
    kept = synthesize(double_integrator(), keep_limits=CELLS)
    for more in ({"dwell": 0.5}, {"hold_off": 0.5}):
        with pytest.raises(ProblemError, match="limits are kept without"):
            export(kept, "c", tmp_path, **more)


def test_cells_that_are_too_coarse_are_told():
    with pytest.warns(CapsynWarning, match="limits cannot be kept from any cell: cells are wider"):
        policy = synthesize(double_integrator(), keep_limits=KeepLimits(cells=10))
    assert not policy.keeps_limits(policy.domain.sample(100)).any()
