"""What says whether limits are kept goes into every export, beside the policy that keeps them."""

import csv
import json

import numpy as np
import pytest

from capsyn import Box, KeepLimits, Switching, compress, export, synthesize
from capsyn.errors import ProblemError
from capsyn.exports.export import TARGETS
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import NOT_FINITE, OK, OUTSIDE, Plan
from capsyn.limits.telling import KEPT, NOT_KEPT, limits_policy
from support.exports.c_machines import Library
from support.exports.c_plans import files
from support.exports.policies import RUNNERS, assert_equal, module
from support.processes.command_line import capsyn
from support.proofs.limits import double_integrator

CELLS = KeepLimits(cells=(120, 90))


@pytest.fixture(scope="module")
def kept():
    return synthesize(double_integrator(), keep_limits=CELLS)


@pytest.fixture(scope="module")
def remembering():
    problem = double_integrator(switching=Switching(price="3%"), delay=0.05)
    return synthesize(problem, keep_limits=CELLS)


@pytest.fixture(scope="module")
def told():
    problem = double_integrator(
        exogenous=Box([0.2], [1.0], names=["wall"]),
        limits=lambda x, w: [x[0] - w[0], -1.8 - x[0], x[1] - 1.4, -1.4 - x[1]],
        dynamics=lambda x, u, w: [x[1], u[0]],
        running_cost=lambda x, w: (x[0] - w[0]) ** 2 + 0.1 * x[1] ** 2,
    )
    return synthesize(problem, keep_limits=KeepLimits(cells=(60, 45, 4)))


@pytest.mark.parametrize("name", ["kept", "remembering", "told"])
def test_it_says_what_the_policy_says(name, request):
    policy = request.getfixturevalue(name)
    z = policy.space.sample(20_000, 1)
    wanted = np.all([policy.keeps_limits(z, current=k) for k in range(3)], axis=0)
    assert (limits_policy(policy)(z) == np.where(wanted, KEPT, NOT_KEPT)).all()
    assert 0.1 < wanted.mean() < 0.9
    tree = compress(policy)
    assert (limits_policy(tree)(z) == limits_policy(policy)(z)).all()
    assert limits_policy(policy)(policy.space.upper + 1) == NOT_KEPT


def test_every_target_has_it(kept, tmp_path):
    written = export(kept, list(TARGETS), tmp_path)
    for target in TARGETS:
        own = [p.name for p in written if p.parent == tmp_path / target]
        beside = [p.name for p in written if p.parent == tmp_path / target / "limits"]
        assert any(name.startswith("double_integrator") for name in own)
        assert any(name.startswith("limits_double_i") for name in beside)
        assert {"golden.csv", "certificate.json"} <= set(beside)
        data = json.loads((tmp_path / target / "limits" / "certificate.json").read_text())
        assert data["policy"] == "limits double-integrator"
    plain = export(synthesize(double_integrator()), "python", tmp_path / "plain")
    assert not [path for path in plain if "limits" in path.parts[-2:]]


@pytest.mark.parametrize("to", RUNNERS)
def test_languages_give_its_symbols(to, kept, told, tmp_path):
    assert_equal(to, limits_policy(kept), tmp_path)
    (tmp_path / "told").mkdir()
    assert_equal(to, limits_policy(told), tmp_path / "told")


def test_c_and_python_beside_the_policy(kept, remembering, tmp_path):
    for number, policy in enumerate((kept, remembering)):
        folder = tmp_path / str(number)
        options = {"scale": [0.001, 0.01], "offset": [-0.1, 0.0]}
        export(policy, "python", folder, name="mine", **options)
        made = module(folder / "limits" / "limits_mine.py")
        rng = np.random.default_rng(2)
        readings = rng.uniform([-2500, -200], [2500, 200], (3000, 2))
        states = readings * options["scale"] + options["offset"]
        inside = policy.domain.contains(states)
        every = [policy.keeps_limits(states, current=k) for k in range(3)]
        for row, is_inside, holds in zip(readings, inside, np.all(every, axis=0)):
            wanted = (KEPT, OK) if holds else (NOT_KEPT, OK if is_inside else OUTSIDE)
            assert made.decide(row) == wanted
        assert made.decide([np.nan, 0.0]) == (NOT_KEPT, NOT_FINITE)
        plan = Plan.of(limits_policy(policy))
        golden = golden_vectors(plan)
        library = Library(files(plan, golden), tmp_path / f"c{number}", 2)
        states = policy.domain.sample(20_000, 3)
        symbols, statuses = library.decide(states)
        assert (symbols == limits_policy(policy)(states)).all() and not statuses.any()


def test_golden_vectors_of_the_folder_are_those_of_limits(kept, tmp_path):
    export(kept, "structured-text", tmp_path)
    with open(tmp_path / "limits" / "golden.csv", newline="") as file:
        rows = [row for row in csv.reader(file) if row and not row[0].startswith("#")]
    place = rows[0].index("symbol")
    status = rows[0].index("status")
    values = [row for row in rows[1:] if row[status] == str(OK)]
    states = np.array([[float(v) for v in row[:2]] for row in values])
    symbols = np.array([int(row[place]) for row in values])
    assert len(states) > 500 and (symbols == kept.keeps_limits(states)).all()


def test_the_command_line_tells_both_apart(kept, tmp_path):
    path = tmp_path / "kept.cap"
    kept.save(path)
    command = ["export", str(path), "--to", "python,json", "-o", str(tmp_path / "limits")]
    data = json.loads(capsyn(*command, "--json")[0])
    assert [data["certificate"][to]["target"] for to in ("python", "json")] == ["python", "json"]
    assert {each["policy"] for each in data["certificate"].values()} == {"double-integrator"}
    assert capsyn(*command)[0].count("from where limits are kept:") == 1


def test_what_says_nothing_is_refused():
    with pytest.raises(ProblemError, match="`policy` must be made with `keep_limits`"):
        limits_policy(synthesize(double_integrator()))
