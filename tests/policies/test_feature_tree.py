"""Trees with features as policies: lookups, loops, files, and who refuses them."""

import matplotlib

matplotlib.use("Agg")

import numpy as np
import pytest

import capsyn
from capsyn import Automaton, Policy, online_controller, problems, simulate
from capsyn.cells.feature_tree import Features
from capsyn.errors import ProblemError
from capsyn.integrations.single_lookup import single_lookup
from capsyn.plots.policy import plot_policy
from capsyn.policies.file import content_hash, content_of
from capsyn.policies.lookup import COMPILED_FROM
from capsyn.policies.report import report
from capsyn.programs.program import Program
from capsyn.verification.lyapunov import lyapunov
from support.features import exact, pendulum, walked
from support.policy_files import array, assert_equal, at, delete, read, refuse, rewrite, set_version


@pytest.fixture
def saved(tmp_path):
    exact().save(tmp_path / "tree.cap")
    return tmp_path / "tree.cap"


# lookups


@pytest.mark.parametrize("backend", ["auto", "c", "numpy"])
def test_every_lookup_gives_the_symbol_of_the_cell(backend):
    tree, policy = exact(), pendulum()
    states = policy.domain.lower + (2 * policy.domain.sample(COMPILED_FROM + 7, 4) - 1)
    expected = policy(states, outside="nearest")
    np.testing.assert_array_equal(tree(states, outside="nearest", backend=backend), expected)
    steps = policy.domain.locate(states[:500], policy.cells.counts)
    np.testing.assert_array_equal(walked(tree, steps), expected[:500])


def test_an_unknown_backend_is_refused():
    with pytest.raises(ProblemError, match="^`backend` must be one of"):
        exact()([[1.0, 1.0]], backend="fortran")


def test_no_states_have_no_symbols():
    assert exact()(np.empty((0, 2))).shape == (0,)


def test_single_lookups_give_the_same():
    tree = exact()
    look_up = single_lookup(tree)
    states = tree.domain.sample(200, 5)
    np.testing.assert_array_equal([look_up(x) for x in states], tree(states))


def test_a_value_that_is_no_number_reaches_no_threshold():
    program = Program("f", (("z", 1),), (("features", 1),), (("log", 0),), (1,))
    features = Features(("log",), program, (np.array([0.5, 1.0]),), None)
    steps = np.array([[-1], [0], [1], [2], [3]])
    assert features.with_ranks(steps)[:, 1].tolist() == [0, 0, 0, 1, 2]


# loops


@pytest.mark.parametrize("backend", ["auto", "numpy"])
def test_a_closed_loop_is_that_of_the_policy(backend):
    runs = [
        simulate(p, x0=[0.6, 0.4], duration=2.0, rate=200.0, backend=backend)
        for p in (exact(), pendulum())
    ]
    np.testing.assert_array_equal(runs[0].symbols, runs[1].symbols)
    np.testing.assert_allclose(runs[0].states, runs[1].states, atol=1e-9)


def test_monte_carlo_is_that_of_the_policy():
    runs = [capsyn.monte_carlo(p, 20, within=2.0, seed=3) for p in (exact(), pendulum())]
    one, other = (run.to_json() for run in runs)
    assert one["successes"] == other["successes"] > 0 and one["ended"] == other["ended"]


def test_an_online_controller_takes_it_for_its_default():
    problem = problems.plain("cart-pendulum")
    made = [online_controller(problem, default=p) for p in (exact(), pendulum())]
    for state in ([0.6, 0.4], [2.0, -1.0]):
        one, other = (controller.actions(np.array([state])) for controller in made)
        np.testing.assert_allclose(one.control, other.control)
        np.testing.assert_allclose(one.duration, other.duration)


# what it is not


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (Automaton.of, "has splits by features$"),
        (lambda tree: lyapunov(tree, lambda x: x[1] ** 2), "^a tree with features has no boxes"),
        (lambda tree: tree.cells.boxes(), "^a tree with features has no boxes"),
        (lambda tree: tree.cells.parts(np.zeros((1, 2)), np.ones((1, 2))), "has no boxes"),
    ],
)
def test_who_needs_boxes_refuses_it(use, message):
    with pytest.raises(ProblemError, match=message) as caught:
        use(exact())
    assert "\n" not in str(caught.value)


def test_a_report_tells_its_features():
    features = report(exact())["features"]
    assert features["names"] == ["energy", "cos(theta) * omega"]
    assert features["thresholds"] == [len(t) for t in exact().cells.features.thresholds]
    assert features["margin"] > 1e-9 and features["operations"] > 5
    assert report(capsyn.compress(pendulum()))["features"] is None


def test_it_is_drawn():
    (image,) = plot_policy(exact()).images
    pixels = np.asarray(image.get_array())
    colors, counts = np.unique(pixels.reshape(-1, pixels.shape[-1]), axis=0, return_counts=True)
    assert len(colors) == 2 and counts.min() / counts.sum() == pytest.approx(0.5, abs=0.02)


# files


def test_a_file_gives_the_same_tree(saved):
    back = Policy.load(saved)
    tree = exact()
    assert content_of(back) == content_of(tree) and content_hash(back) == content_hash(tree)
    for name, values in tree.cells.arrays().items():
        np.testing.assert_array_equal(back.cells.arrays()[name], values)
    for one, other in zip(tree.cells.features.thresholds, back.cells.features.thresholds):
        assert one.tobytes() == other.tobytes()
    states = tree.domain.sample(5000, 1)
    np.testing.assert_array_equal(back(states), tree(states))
    assert read(saved)[0]["version"] == 7
    back.save(saved.with_name("again.cap"))
    assert saved.read_bytes() == saved.with_name("again.cap").read_bytes()


def test_other_trees_keep_their_version(tmp_path):
    capsyn.compress(pendulum()).save(tmp_path / "t.cap")
    assert read(tmp_path / "t.cap")[0]["version"] == 2
    assert_equal(Policy.load(tmp_path / "t.cap"), capsyn.compress(pendulum()))


PLACE = ("features", "thresholds")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_version(6), "keys are not those of this format version"),
        (delete("features"), "planes must have 2 coefficients"),
        (at("features")([1]), "features of the tree are of another kind"),
        (delete("features", "margin"), "features of the tree are of another kind"),
        (at("features", "margin")("small"), "margin must be a share"),
        (at("features", "margin")(-1.0), "margin must be a share"),
        (at("features", "names")("ab"), "features of the tree are of another kind"),
        (at("features", "names")(["a"]), "no, or too many, features|must give"),
        (at("features", "names")(["a", "b\n"]), "no printable name"),
        (at("features", "names")(["a", 7]), "no printable name"),
        (at(*PLACE)([[1.0]]), "no, or too many, features"),
        (at(*PLACE)([[1.0, 1.0], [0.0]]), "finite and ascend"),
        (at(*PLACE)([[1.0], []]), "finite and ascend"),
        (at(*PLACE)([[1.0], ["0"]]), "of another kind"),
        (at(*PLACE)([[1.0], 3]), "of another kind"),
        (at(*PLACE)([[0.0], [0.0]]), "splits an axis beyond its lattice"),
        (at("features", "program", "instructions", 0)(["exec", 0]), "unknown operation"),
        (at("features", "program", "instructions", 0)(["sin", 99]), "operands of 'sin'"),
        (at("features", "program", "inputs")([["z", 3]]), "program"),
        (at("features", "program", "results")([0]), "malformed: results"),
        (array("planes", lambda x: np.zeros((0, 2), np.int32)), "planes must have 4"),
        (
            array("split", lambda x: np.where(x == 3, 2, x).astype(np.int32)),
            "is in no split|beyond",
        ),
    ],
)
def test_damaged_files_are_refused(saved, change, message):
    rewrite(saved, change)
    refuse(saved, message)


def test_a_feature_that_is_in_no_split_is_refused(saved):
    def change(document, arrays):
        features = document["policy"]["features"]
        features["names"].append("more")
        features["thresholds"].append([0.0])
        features["program"]["outputs"] = [["features", 3]]
        features["program"]["results"].append(0)

    rewrite(saved, change)
    refuse(saved, "planes must have 5|in no split")


def test_features_of_cells_are_refused(tmp_path):
    pendulum().save(tmp_path / "p.cap")

    def change(document, arrays):
        document["version"] = 7
        document["policy"]["features"] = exact().cells.features.to_json()

    rewrite(tmp_path / "p.cap", change)
    refuse(tmp_path / "p.cap", "keys are not those of this format version")
