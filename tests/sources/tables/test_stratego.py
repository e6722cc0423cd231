"""Strategies of UPPAAL Stratego: the tree has the symbol that the file says, at all states."""

import hashlib
import io
import json
import math

import numpy as np
import pytest

import capsyn
from capsyn import Alphabet, Policy
from capsyn.errors import OutsideDomainError, ProblemError
from capsyn.sources.callables import labels_of
from capsyn.sources.grid_files import read_table
from capsyn.sources.table import Table
from capsyn.sources.tables.stratego import read_stratego
from support.exports.policies import assert_equal
from support.processes.command_line import capsyn as command
from support.processes.command_line import error_of
from support.tables import stratego


@pytest.fixture
def file(tmp_path):
    def write(plain):
        path = tmp_path / "strategy.json"
        path.write_text(plain if isinstance(plain, str) else json.dumps(plain, indent=1))
        return path

    return write


def costs(plain, key, point, action):
    """Return the cost of an action in a state, by walking through the file."""
    entry = plain["regressors"].get(f"({','.join(map(str, key)) or 1})")
    node = math.inf if entry is None else entry["regressor"].get(action, "inf")
    while isinstance(node, dict):
        node = node["low" if point[node["var"]] <= node["bound"] else "high"]
    return math.inf if node == "inf" else node * (1 if entry is None or entry["minimize"] else -1)


def expected(plain, states, n):
    """Return the texts of the actions of least cost, the first of equal ones; None for none."""
    found = []
    for state in states:
        key, point = [int(v) for v in state[:n]], state[n:]
        each = [(costs(plain, key, point, action), action) for action in sorted(plain["actions"])]
        cost, action = min(each)
        found.append(plain["actions"][action] if cost < math.inf else None)
    return found


def states_of(strategy, count, around=1, seed=0):
    """Return states in and around the domain, at valuations of the file and others."""
    rng = np.random.default_rng(seed)
    box = strategy.box(around)
    states = box.lower + rng.uniform(-0.2, 1.2, size=(count, box.n)) * box.widths
    n = strategy.discrete
    inner = box.lower[:n], box.upper[:n] - 1
    states[:, :n] = np.ceil(np.clip(states[:, :n], *inner)) if n else 0
    return states


def texts(policy, symbols):
    names = [*policy.alphabet.names, None]
    return [names[k] for k in symbols]


@pytest.mark.parametrize("keys", [((),), ((3,), (4,), (7,)), ((0, 1), (0, 3), (2, 1))])
@pytest.mark.parametrize("minimize, numbers", [(1, 100), (0, 100), (1, 4)])
def test_trees_have_the_actions_of_the_file(keys, minimize, numbers, file):
    plain = stratego(keys, seed=len(keys), minimize=minimize, numbers=numbers)
    strategy = read_table(file(plain))
    states = states_of(strategy, 1500)
    wanted = expected(plain, states, strategy.discrete)
    assert None in wanted or not strategy.discrete
    tree = strategy.policy("learned")
    assert texts(tree, strategy(states)) == wanted
    for backend in ("c", "numpy"):
        found = np.where(tree.leaves(states, True, backend) < 0, -1, 0)
        given = found == 0
        found[given] = tree(states[given], backend=backend)
        assert texts(tree, found) == wanted
    assert tree.domain.names == tuple(f"d{k}" for k in range(strategy.discrete)) + (
        "Ball[0].p",
        "Ball[0].v",
    )
    assert tree.guarantee.agreement == 1 and tree.guarantee.changed == 0


def test_states_of_many_valuations_have_the_symbols_of_each(file):
    keys = tuple((a, b) for a in range(-3, 4) for b in range(0, 9, 2))
    plain = stratego(keys, depth=2)
    strategy = read_stratego(file(plain))
    rng = np.random.default_rng(1)
    states = np.column_stack([rng.integers(-5, 6, (600, 2)), rng.uniform(-5, 5, (600, 2))])
    assert texts(strategy, strategy(states)) == expected(plain, states, 2)
    states[:4, 0] = np.nan, 0.5, np.inf, -0.0
    assert (strategy(states[:3]) == -1).all()
    zero = states[3:4] + [0.0, 0, 0, 0]  # no longer -0.0
    assert strategy(states[3:4]) == strategy(zero) and not np.signbit(zero[0, 0])
    assert strategy(states[:0]).shape == (0,)


def test_a_file_is_read_once(file, monkeypatch):
    """What is hashed is what was read, though the file may change meanwhile."""
    path = file(stratego(seed=2))
    wanted = hashlib.sha256(path.read_bytes()).hexdigest()

    def open_and_change(name, *options):
        file = io.BytesIO(path.read_bytes())
        path.write_text("{}")
        return file

    monkeypatch.setattr("capsyn.sources.text.open", open_and_change, raising=False)
    assert read_stratego(path).source == wanted


def test_states_at_a_bound_are_low(file):
    plain = stratego(seed=5)
    strategy = read_stratego(file(plain))
    tree = strategy.policy()
    states = []
    for key, trees in strategy.regressors.items():
        for regressor in trees.values():
            rows = np.flatnonzero(regressor.axis >= 0)
            for axis, bound in zip(regressor.axis[rows], regressor.bound[rows]):
                for at in (bound, np.nextafter(bound, -9), bound + 1e-6, bound - 1e-6):
                    states.append([*key, *(at if k == axis else 0.1 for k in (0, 1))])
    states = np.array(states)
    assert texts(tree, tree(states, outside=-1)) == expected(plain, states, 2)


def test_a_strategy_goes_where_policies_go(file, tmp_path):
    strategy = read_stratego(file(stratego(seed=3)))
    tree = strategy.policy("learned", outside=0, default=[7.0])
    tree.save(tmp_path / "learned.cap")
    loaded = Policy.load(tmp_path / "learned.cap")
    states = states_of(strategy, 3000, around=0)
    inside = tree.covers(states)
    assert 0 < inside.sum() < 3000
    np.testing.assert_array_equal(loaded(states), tree(states))
    np.testing.assert_array_equal(tree(states[inside]), strategy(states[inside]))
    assert loaded.guarantee == tree.guarantee and loaded.gaps
    for to in ("python", "json"):
        assert_equal(to, loaded, tmp_path)
    with pytest.raises(ProblemError, match="must be one of cells"):
        capsyn.compress(tree)
    with pytest.raises(OutsideDomainError):
        strategy.policy(outside="error")([1.0, 1.0, 0.0, 0.0])


def test_cells_may_be_made_of_a_strategy(file):
    strategy = read_stratego(file(stratego(((),), seed=4, depth=2)))
    made = capsyn.subdivide(
        labels_of(strategy, strategy.alphabet), strategy.box(), strategy.alphabet
    )
    states = strategy.box().sample(2000)
    assert (made(states) == strategy(states)).mean() > 0.9
    assert capsyn.compress(made).node_count > 1


def test_without_continuous_variables_it_is_a_table(file):
    plain = stratego(((0, 1), (2, 3), (2, 1)))
    plain["pointvars"] = []
    costs = ({"0": 2.5, "3": 1}, {"0": 1, "1": 1.0, "3": 3}, {"1": "inf", "0": 4})
    for entry, trees in zip(plain["regressors"].values(), costs):
        entry["regressor"] = trees
    table = read_stratego(file(plain))
    assert isinstance(table, Table) and table.counts == (3, 3)
    assert table.alphabet.names == tuple(plain["actions"][k] for k in "013")
    assert table.masks.tolist() == [[4, 0, 0], [0, 0, 0], [1, 0, 3]]
    alphabet = Alphabet([[0, 1], [1, 0], [1, 1]], ["a", "b", "c"])
    assert read_stratego(file(plain), alphabet).alphabet == alphabet


def test_the_domain_may_be_given(file):
    plain = stratego(((),), seed=6)
    strategy = read_stratego(file(plain), domain={"Ball[0].p": (-0.3, 40.0)})
    assert strategy.box().lower[0] == -0.3 and strategy.box().upper[0] == 40
    states = strategy.box().sample(1000)
    tree = strategy.policy(outside="error")
    assert texts(tree, tree(states)) == expected(plain, states, 0)
    with pytest.raises(ProblemError, match="must name continuous variables among Ball.*; got 'p'"):
        read_stratego(file(plain), domain={"p": (0, 1)})


@pytest.mark.parametrize(
    "domain, words",
    [
        ({"t": 5}, "must have a pair of bounds for 't'; got 5"),
        ({"t": (0, 1, 2)}, "must have a pair of bounds for 't'; got "),
        ({"t": None}, "must have a pair of bounds for 't'; got None"),
        ({"t": (1, 1)}, "must have a lower bound below the upper for 't'; got 1.0 and 1.0"),
        ({"t": ("a", 1)}, "`domain['t']` must be "),
        ([("t", (0, 1))], "must map names of variables to pairs of bounds; got "),
        (3, "must map names of variables to pairs of bounds; got 3"),
    ],
)
def test_a_domain_that_is_none_is_told(domain, words, tmp_path):
    with pytest.raises(ProblemError) as error:
        read_stratego(tmp_path / "none.json", domain=domain)
    assert words in str(error.value) and "`domain" in str(error.value)


def test_a_table_has_no_continuous_variables_to_bound(file):
    plain = stratego(((0,), (1,)), depth=0)
    plain["pointvars"] = []
    with pytest.raises(ProblemError, match="continuous variables among none; got 'd0'"):
        read_stratego(file(plain), domain={"d0": (0, 1)})


def changed(plain, **changes):
    return plain | changes


def with_regressor(tree, key="(1)"):
    plain = stratego(((),))
    entry = plain["regressors"]["(1)"] | {"regressor": {"0": tree}}
    return plain | {"regressors": {key: entry}}


@pytest.mark.parametrize(
    "plain, words",
    [
        ([], "must be a list of states, as Storm"),
        ({}, "expected 'state->regressor' for 'type'; got None"),
        (stratego() | {"type": "state->zone"}, "expected 'state->regressor' for 'type'"),
        (stratego() | {"representation": "list"}, "expected 'map' for 'representation'"),
        (stratego() | {"statevars": [3]}, "a list of texts for 'statevars'; got a list of 1"),
        (stratego() | {"pointvars": [str(k) for k in range(15)]}, "expected 1 to 16 variables"),
        (stratego() | {"actions": {"0": 1}}, "expected an object of texts for 'actions'"),
        (stratego() | {"actions": {}}, "expected an action of 'actions'; got "),
        (stratego() | {"regressors": {}}, "expected an object for 'regressors'"),
        (stratego() | {"regressors": {"(0,1)": 1}}, "regressor '(0,1)': expected an object with"),
        (with_regressor(1.0, "(2)"), "expected (1), where there are no discrete variables"),
        (with_regressor("low"), "a number, or an object with var, bound, low and high"),
        (with_regressor({"var": 2, "bound": 0, "low": 1, "high": 2}), "'var', 0 to 1; got 2"),
        (with_regressor({"var": 0, "bound": "0", "low": 1, "high": 2}), "a number for 'bou"),
        (with_regressor({"var": 0, "bound": 1e300, "low": 1, "high": 2}), "within +-1e+290"),
        (with_regressor("inf"), "expected an action with a number at some state; got 'none'"),
        ('{"type": NaN}', "is no table: numbers must be finite; got NaN"),
        ('{"type": 1e999}', "is no table: numbers must be finite; got '1e999'"),
        ('{"type": 1' + "0" * 5000 + "}", "whole numbers must have at most 300 digits"),
        ('{"type": 1, "type": 2}', "is no table: the key 'type' comes twice in an object"),
        ('{"type": ' + "[" * 100_000, "is no table: its JSON is nested too deeply"),
        ('{"type": ' * 100_000, "is no table: its JSON is nested too deeply"),
        ('{"type": ', "is no table: Expecting value: line 1"),
    ],
)  # fmt: skip
def test_other_files_are_refused(plain, words, file):
    with pytest.raises(ProblemError) as error:
        read_table(file(plain))
    assert words in str(error.value) and "\n" not in str(error.value)
    assert len(str(error.value)) < 500


def test_the_command_imports_a_strategy(file, tmp_path):
    path, made = file(stratego(seed=8)), tmp_path / "s.cap"
    out, _ = command("import", path, "-o", made, "--domain", "Ball[0].v=-6:6, Ball[0].p=-2:2")
    policy = Policy.load(made)
    assert policy.outside == "nearest" and policy.domain.lower[2] == -2 and "tree" in out
    command("import", path, "-o", made, "--states", "a,b,p,v", "--outside", "error")
    assert Policy.load(made).domain.names == ("a", "b", "p", "v")
    for options, words in (
        (["--periodic", "a"], "--periodic is for tables; the file has a strategy"),
        (["--domain", "Ball[0].p=2"], "--domain must be NAME=LOW:HIGH; got 'Ball[0].p=2'"),
        (
            ["--domain", "Ball[0].p=2:2"],
            "must have a lower bound below the upper for 'Ball[0].p'",
        ),
        (["--inputs", "u"], "`inputs` (--inputs) is for files of format csv only"),
        (["--format", "storm"], "must be a list of states, as Storm writes it"),
    ):
        assert words in error_of("import", path, "-o", made, *options)


def test_actions_may_have_one_text_and_names_that_are_taken(file):
    plain = stratego(((1,), (2,)), depth=0)
    plain["actions"] = {"0": "default", "1": "a { tau }", "2": "a  { tau }", "3": "b"}
    for k, entry in enumerate(plain["regressors"].values()):
        entry["regressor"] = {str(k): 1.0, str(k + 1): 1.0, "3": 2.0}
    strategy = read_stratego(file(plain))
    assert strategy.alphabet.names == ("default_", "a { tau } #1", "a { tau } #2", "b")
    assert strategy([[1, 0.0, 0.0], [2, 0.0, 0.0], [3, 0.0, 0.0]]).tolist() == [0, 1, -1]


def test_bounds_may_be_near_each_other(file):
    """Where floating point is not as fine as the lattice, it has fewer steps."""
    bounds = 1e9 + 1e-6 * np.arange(40)
    tree = 39.0
    for k in range(39):
        tree = {"var": 0, "bound": bounds[38 - k], "low": float(38 - k), "high": tree}
    plain = with_regressor(tree)
    plain["regressors"]["(1)"]["regressor"]["1"] = 19.5
    strategy = read_stratego(file(plain))
    tree = strategy.policy()
    states = np.column_stack([bounds, np.zeros(40)])
    assert texts(tree, tree(states)) == expected(plain, states, 0)
    assert tree.cells.counts[0] < 1 << 30
