"""The choice of an alphabet: known answers, brute force, what is kept, and resuming."""

import dataclasses
import itertools

import numpy as np
import pytest

from capsyn import Alphabet, Ball, Box, Problem, SsacSettings, Switching, choose_alphabet, problems
from capsyn.alphabets.asked import Asked
from capsyn.alphabets.loops.alphabet_loops import AlphabetLoops
from capsyn.alphabets.search.exchange import Exchange
from capsyn.alphabets.search.moving import Movable
from capsyn.alphabets.search.objective import Objective
from capsyn.alphabets.search.scores import WORST, Scores
from capsyn.alphabets.search.storage import Storage
from capsyn.alphabets.spread import Pool
from capsyn.errors import ProblemError
from capsyn.verification.trials import TrialOptions

QUICK = {"duration": 3.0, "rate": 10, "starts": 16, "fresh": 50, "policies": False}
PLAN = TrialOptions.of(trials=16, duration=3.0, rate=10, seed=5)


def cart(**changes):
    """A cart that is pushed by two motors, the second turned."""
    settings = {"rule": "steepest", "control_weight": 0.05, "steps": 6, "sample_time": 0.1}
    settings |= changes.pop("settings", {})
    return Problem(
        **{
            "name": "cart",
            "dynamics": lambda x, u: [x[1] + 0.3 * u[1], u[0] - 0.4 * u[1] - 0.2 * x[1] ** 3],
            "domain": Box([-1, -1], [1, 1]),
            "alphabet": [[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0]],
            "default": [0.0, 0.0],
            "horizon": 0.6,
            "running_cost": lambda x: x[0] ** 2 + 0.3 * x[1] ** 2,
            "target": Ball([0, 0], 0.15),
            "outside": "nearest",
            "settings": SsacSettings(**settings),
        }
        | changes
    )


def scores_of(problem, candidates, objective, prices=None):
    pool = Asked.of(problem, candidates, None, (), (), None, (), {}).pool.candidates
    loops = AlphabetLoops.of(problem, pool, PLAN)
    prices = np.zeros(len(pool)) if prices is None else prices
    return Scores(loops, Objective.of(objective), prices, Storage(None, {}), PLAN.trials)


def test_the_pendulum_takes_both_ends_of_its_range():
    given = problems.get("cart-pendulum")
    settings = dataclasses.replace(given.settings, control_weight=0.0, sample_time=0.02)
    problem = given.replace(settings=settings)
    study = choose_alphabet(problem, Box([-5], [5]), 2, **QUICK | {"duration": 8, "rate": 50})
    assert sorted(study.alphabet.values.ravel()) == [-5, 5]


def test_exchange_finds_what_brute_force_finds():
    """In 12 random sets of candidates it is the best set, or nearly; never worse than a start."""
    problem, hits = cart(), 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        values = np.vstack([[0.0, 0.0], rng.uniform(-2, 2, (6, 2))])
        scores = scores_of(problem, values, {"cost": 1, "effort": 0.05 * (seed % 3)})
        everything = tuple(range(len(scores.loops.pool)))
        count = 2 + seed % 2
        exchange = Exchange(scores, everything, frozenset(), count)
        starts = [exchange.fitted(everything), exchange.fitted([1, 2])]
        found = min(exchange.improved(start) for start in starts)
        assert found[0] <= min(scores.of(starts)) and len(found[1]) <= count
        sets = [s for k in range(1, count + 1) for s in itertools.combinations(everything, k)]
        hits += found[0] <= min(scores.of(sets))
    assert hits >= 10


def test_duplicates_dominated_and_useless_candidates_do_not_survive():
    problem = cart(dynamics=lambda x, u: [x[1], u[0] + u[1]])
    values = [[0, 0], [1, 0], [-1, 0], [1, 0], [0.5, 0.5], [3, -2], [0, -1], [0.0, 1e-7]]
    study = choose_alphabet(problem, values, 6, objective={"cost": 1, "effort": 0.02}, **QUICK)
    names = set(study.alphabet.names)
    assert len(study.candidates) == 4  # each effect once, by the least effort
    chosen = study.alphabet.values.sum(axis=1).tolist()
    assert len(chosen) == len(set(chosen)) and names <= set(study.candidates.names)
    least = choose_alphabet(problem, [[0, 0], [1, 0], [-1, 0], [40, 0]], 4, **QUICK).alphabet
    assert 40 not in least.values  # no loop uses it


def test_what_is_kept_excluded_and_priced():
    problem = cart()
    grid = Box([-1, -1], [1, 1])
    study = choose_alphabet(problem, grid, 3, keep=[[0, 0]], exclude=[[1, 1]], **QUICK)
    assert [0, 0] in study.alphabet.values.tolist() and [1, 1] not in study.alphabet.values.tolist()
    assert len(study.candidates) == 24 and len(study.alphabet) <= 3
    dear = dict.fromkeys(study.candidates.names, 100.0)
    cheap = choose_alphabet(problem, study.candidates, 3, prices=dear, **QUICK)
    assert len(cheap.alphabet) == 1  # another one costs more than it gains
    best = next(row for row in cheap.table if row.kind == "chosen")
    assert 100 < best.objective < 110 and best.low <= best.objective <= best.high


def test_own_alphabets_are_starts_and_are_judged():
    problem = cart()
    candidates = [[0, 0], [1, 0], [-1, 0], [0, 1]]
    own = [[[0.7, 0.7], [-0.7, -0.7]], Alphabet([[0, 1], [0, -1]], inputs=["u1", "u2"])]
    study = choose_alphabet(problem, candidates, 2, own=own, **QUICK)
    assert len(study.candidates) == 7
    rows = [row for row in study.table if row.kind == "own"]
    assert [len(row.alphabet) for row in rows] == [2, 2, 3]
    chosen = study.chosen[0]
    assert chosen.objective <= min(row.objective for row in rows if len(row.alphabet) == 2) + 0.02


def test_the_symbol_outside_the_domain_stays():
    study = choose_alphabet(cart(outside=1), Box([-1, -1], [1, 1]), 2, **QUICK)
    assert [1, 0] in study.alphabet.values.tolist()


def test_levels_of_a_box_move_and_are_never_worse():
    problem = cart(
        dynamics=lambda x, u: [x[1], u[0]], alphabet=[-1.0, 1.0], default=0.0, target=None,
        settings={"control_weight": 0.3},
    )  # fmt: skip
    scores = scores_of(problem, np.linspace(-2, 2, 5), {"cost": 1, "effort": 0.3})
    moves = Movable(scores, Box([-2], [2]), Pool(scores.loops.pool, (2,)))
    start = np.array([[-2.0], [0.0], [1.0]])
    (first,) = moves.of([start])
    assert moves.has_effort
    for values in (moves.searched(first, start, lambda _: None)[1], moves.lloyd(start)):
        assert 0.0 in values and np.abs(values).max() <= 2 and len(values) <= 3
    score, values = moves.searched(first, start, lambda _: None)
    assert score < first and not set(values.ravel()) <= set(np.linspace(-2, 2, 5))


def test_a_search_that_was_killed_goes_on_with_the_same_result(tmp_path):
    problem, box = cart(), Box([-1, -1], [1, 1])
    whole = choose_alphabet(problem, box, [2, 3], **QUICK)
    said = []

    def stops(text):
        said.append(text)
        if len(said) == 8:
            raise KeyboardInterrupt

    kept = {"storage": tmp_path / "study.db"} | QUICK
    with pytest.raises(KeyboardInterrupt):
        choose_alphabet(problem, box, [2, 3], progress=stops, **kept)
    again = choose_alphabet(problem, box, [2, 3], **kept)
    assert again.to_json() == whole.to_json()
    with pytest.raises(ProblemError, match="has another objective"):
        choose_alphabet(problem, box, 2, objective="effort", **kept)


def test_a_storage_of_something_else_is_refused(tmp_path):
    (tmp_path / "text").write_text("no database" * 100)
    with pytest.raises(ProblemError, match="`storage` cannot be used"):
        choose_alphabet(cart(), Box([-1, -1], [1, 1]), 2, storage=tmp_path / "text", **QUICK)
    Storage(tmp_path / "own", {"seed": "1"}).add({"a": [0, 1.5, [3, 4]]})
    assert Storage(tmp_path / "own", {"seed": "1"})["a"] == [0, 1.5, [3, 4]]
    for k, wrong in enumerate([5, [0, 1.5], [0, "1", []], [-1, 1.0, []], [0, 1.0, [0.5]], None]):
        path = tmp_path / str(k)
        Storage(path, {"seed": "1"}).add({"a": wrong})
        with pytest.raises(ProblemError, match="was not made by a search among alphabets"):
            Storage(path, {"seed": "1"})


def test_loops_that_differ_do_not_share_a_storage(tmp_path):
    problem, box = cart(), Box([-1, -1], [1, 1])
    kept = {"storage": tmp_path / "study.db", "disturbance": lambda t: [0.0, 0.0]} | QUICK
    choose_alphabet(problem, box, 2, **kept)
    with pytest.raises(ProblemError, match="another loops"):
        choose_alphabet(problem, box, 2, **kept | {"disturbance": lambda t: [0.0, 0.9]})
    with pytest.raises(ProblemError, match="another objective"):
        choose_alphabet(problem, box, 2, objective={"cost": 1.0000001}, **kept)
    with pytest.raises(ProblemError, match="another number of starts: '16'; got '17'"):
        choose_alphabet(problem, box, 2, **kept | {"starts": 17})


def test_prices_are_those_of_values_whatever_their_names():
    problem, values = cart(), [[0, 0], [1, 0], [-1, 0], [0, 1]]
    candidates = Alphabet(values, names=["off", "a", "b", "c"])
    own = [[[0, 0], [1, 0], [0, 1]], ["off", "a", "c"]]
    study = choose_alphabet(problem, candidates, 2, prices={"a": 10.0, "c": 20}, own=own, **QUICK)
    rows = [r for r in study.table if {*map(tuple, r.alphabet.values)} == {(0, 0), (1, 0), (0, 1)}]
    assert len({row.objective for row in rows}) == 1 and rows[0].objective > 30


def test_symbols_have_exits_where_transitions_are_forbidden():
    rules = Switching(forbidden=[("a", "b"), ("b", "a")])
    three = Alphabet([[0, 0], [1, 0], [-1, 0]], names=["off", "a", "b"])
    problem = cart(alphabet=three, switching=rules)
    study = choose_alphabet(problem, three, 2, prices={"off": 100.0}, **QUICK)
    assert set(study.alphabet.names) != {"a", "b"}
    scores = scores_of(problem, three, {"cost": 1})
    assert scores.of([(1, 2)]) == [WORST] and scores.of([(0, 1, 2)])[0] < WORST


def test_what_the_objective_weighs_keeps_a_candidate_of_the_same_effect():
    problem = cart(dynamics=lambda x, u: [x[1], 2 * u[0] + u[1]])
    values = [[0, 0], [1, 0], [0.8, 0.4], [-1, 0], [-0.8, -0.4]]
    fuel = {"cost": 1, "fuel": 1}
    assert len(choose_alphabet(problem, values, 3, **QUICK).candidates) == 3
    study = choose_alphabet(problem, values, 3, objective=fuel, **QUICK)
    assert len(study.candidates) == 5 and [0.8, 0.4] not in study.alphabet.values.tolist()


def test_an_input_of_one_value_stays_there():
    problem = cart(target=None, settings={"control_weight": 0.3})
    study = choose_alphabet(problem, Box([-1, 0.5], [1, 0.5]), 2, steps=3, **QUICK)
    assert set(study.alphabet.values[:, 1]) == {0.5}


def test_lost_loops_are_worse_than_any_cost():
    fast = cart(outside="error", dynamics=lambda x, u: [x[1], 3 * x[0] + 4 * u[0]])
    scores = scores_of(fast, [[0, 0], [1, 0], [-1, 0]], {"cost": 1})
    none, both = scores.of([(0,), (0, 1, 2)])
    assert none[0] > both[0] and none > both


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"problem": 3}, "`problem` must be a Problem; got 3"),
        ({"count": 0}, "`count` must be"),
        ({"count": []}, "`count` must be a whole number >= 1, or several; got none"),
        (
            {"objective": {"speed": 1}},
            "`objective` must be weights by name, of cost, .* got 'speed'",
        ),
        ({"objective": {"cost": 0}}, "got no weight that is not 0"),
        ({"objective": {"cost": -1}}, "`objective cost` must be"),
        ({"keep": ["nothing"]}, "`keep` must be candidates, by name or value; got 'nothing'"),
        ({"keep": [[0, 0]], "exclude": [[0, 0]]}, "`exclude` must leave what is kept"),
        ({"keep": [[0, 0], [1, 0], [-1, 0]]}, "`count` must be at least the 3 symbols"),
        ({"prices": {"x": 1}}, "`prices` must name candidates; got 'x'"),
        ({"own": ["off"]}, "`own` must"),
        ({"candidates": [[1, 2, 3]]}, "`candidates` must have shape"),
        ({"count": 2.5}, "`count` must be"),
        ({"keep": 5}, "`keep` must be a list; got 5"),
        ({"keep": "none"}, "`keep` must be a list; got 'none'"),
        ({"own": 5}, "`own` must be a list; got 5"),
        ({"progress": 5}, "`progress` must be a function"),
        ({"trials": 5}, "there is no argument `trials` here"),
        ({"synthesis": {"speed": 1}}, "`synthesis` must be arguments of capsyn.synthesize"),
        ({"starts": 0}, "`starts` must be"),
        ({"fresh": 1}, "`fresh` must be"),
        ({"cost": 3}, "`cost` must be a function"),
        ({"executor": None}, "there is no argument `executor`"),
        ({"objective": "failures", "problem": cart(target=None)}, "`objective` .* target"),
        ({"objective": "time", "problem": cart(target=None)}, "`objective` .* target"),
    ],
)
def test_what_cannot_be_used_is_one_line(changes, said):
    given = {"problem": cart(), "candidates": Box([-1, -1], [1, 1]), "count": 2} | QUICK
    with pytest.raises(ProblemError, match=said) as error:
        choose_alphabet(**given | changes)
    assert "\n" not in str(error.value)


def test_prices_of_switches_and_least_times_count():
    problem = cart(switching=Switching(price={"u1": 0.5, "u2": 0.0}, hold={"u1": 0.3}))
    study = choose_alphabet(
        problem, Box([-1, -1], [1, 1]), 3, objective={"cost": 1, "switches": 0.1}, **QUICK
    )
    assert study.chosen[0].figures["switches"] < 4
