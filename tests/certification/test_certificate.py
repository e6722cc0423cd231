"""What a certificate says: figures, sentences, evidence in a policy's file."""

import copy
import json

import numpy as np
import pytest

from capsyn import Box, Policy
from capsyn.cells.run_lengths import runs_of
from capsyn.certification.cell_map import NO_START, OPEN, PROVED, REFUTED, STAYS, cell_map
from capsyn.errors import ProblemError
from capsyn.policies.evidence import MOST_MAP_CELLS, MOST_MAP_TEXT, is_evidence
from capsyn.policies.report import report
from capsyn.verification.sentences import evidence_rows, headlines, proved_share
from support.policy_files import full, refuse, rewrite
from support.proofs.certificates import by_hand, complete

SQUARE = Box([0, -2], [1, 2], names=["level", "flow"], units=["m", ""])


def known(data):
    """Return the numbers of a map, in the shape of its cells."""
    return np.repeat(*runs_of(data["runs"])).reshape(data["counts"])


def sentence(certificate):
    return headlines({"certificate": certificate.to_json()})["certificate"]


def test_cells_are_told_apart():
    statuses = by_hand(SQUARE, (20, 10)).cells.statuses().reshape(20, 10)
    assert statuses[0, 0] == NO_START and statuses[10, 5] == PROVED
    assert statuses[16, 3] == OPEN and statuses[17, 8] == REFUTED
    assert (statuses == REFUTED).sum() == 1


def test_a_cell_that_is_proved_in_part_is_open():
    cells = by_hand(SQUARE, (20, 10)).cells
    cells.arrives[105] = 0.999
    assert cells.statuses()[105] == OPEN


def test_the_figures_are_plain():
    certificate = by_hand(SQUARE, (20, 10))
    data = json.loads(json.dumps(certificate.to_json()))
    assert data["states"] == ["level", "flow"] and data["units"] == ["m", ""]
    assert data["cells"] == [20, 10] and data["time_unit_name"] == "second"
    (refuted,) = data["refuted"]
    assert refuted == {"state": [0.875, 1.4], "failure": "stands still"}
    replayed = by_hand(SQUARE, (20, 10), replays=("capsyn simulate x",)).to_json()
    assert replayed["refuted"][0]["replay"] == "capsyn simulate x"


@pytest.mark.parametrize("field", ["within", "switch_rate"])
def test_figures_that_are_not_finite_are_none(field):
    data = by_hand(SQUARE, (20, 10), **{field: np.inf}, ripple=np.full((2, 2), np.nan)).to_json()
    assert data[field] is None and data["ripple"] is None


def test_a_map_of_few_cells_is_exact():
    cells = by_hand(SQUARE, (20, 10)).cells
    data = by_hand(SQUARE, (20, 10)).evidence()["map"]
    numbers = known(data).ravel()
    assert (numbers & 3 == cells.statuses()).all()
    assert (numbers & STAYS > 0).tolist() == cells.stays.tolist()


@pytest.mark.parametrize("counts", [(1025, 1024), (997, 991), (4, 700_001), (41, 43, 47, 31)])
def test_a_large_map_is_coarser_and_says_no_more_than_is_proved(counts):
    rng = np.random.default_rng(1)
    statuses = rng.integers(0, 4, counts).astype(np.uint8)
    stays = rng.random(counts) < 0.999
    data = cell_map(counts, statuses.ravel(), stays.ravel())
    assert np.prod(data["counts"]) <= MOST_MAP_CELLS and len(data["runs"]) <= MOST_MAP_TEXT
    numbers = known(data)
    for place in rng.integers(0, data["counts"], (50, len(counts))):
        ends = ((k * c / m, (k + 1) * c / m) for k, c, m in zip(place, counts, data["counts"]))
        cells = tuple(
            slice(int(np.floor(low + 1e-9)), int(np.ceil(high - 1e-9))) for low, high in ends
        )
        assert numbers[tuple(place)] & 3 >= statuses[cells].max()
        assert stays[cells].all() or not numbers[tuple(place)] & STAYS


def test_the_sentence_of_a_whole_proof():
    ripple = np.array([[0.45, 0.55], [-0.2, 0.2]])
    assert sentence(complete(SQUARE, (20, 10), ripple=ripple)) == (
        "100% of the starts arrive in the target within 1.5 s, and then stay in a box: ripple "
        "level in [0.45, 0.55] m, flow in [-0.2, 0.2]; at most 13.24 switches / s"
    )


def test_the_sentence_of_half_a_proof():
    told = sentence(by_hand(SQUARE, (20, 10), staying=0.25, conditions={"avoid": "a box"}))
    assert told.startswith("81.25% of the starts arrive in the target within 1.5 s, 25% then stay")
    assert told.endswith(
        "; until then these do not enter what is to be avoided, nor ever after; refuted from 1 "
        "start; open 17.969%"
    )
    stopped = by_hand(SQUARE, (20, 10), staying=0.0, stopped=True)
    assert "; that they stay is not proved; refuted" in sentence(stopped)
    assert sentence(stopped).endswith("; stopped before its end")
    nothing = complete(SQUARE, (20, 10), arrival=0.0, staying=0.0, within=np.inf, open=1.0)
    assert sentence(nothing) == "no start is proved to arrive; open 100%"


def test_sentences_say_no_more_than_is_proved():
    assert proved_share(1.0) == "100%" and proved_share(1 - 1e-12) == "99.999%"
    assert proved_share(0.57) == "57%" and proved_share(0.0) == "0%"
    ripple = np.array([[0.123456, 0.234561], [-0.234561, 1234.51]])
    told = sentence(complete(SQUARE, (20, 10), ripple=ripple, within=2.10001, open=1e-9))
    assert "within 2.101 s" in told and "open 0.001%" in told
    assert "level in [0.1234, 0.2346] m, flow in [-0.2346, 1235]" in told


def test_the_unit_of_time_is_that_of_the_model():
    told = sentence(complete(SQUARE, (20, 10), conditions={"time_unit": "min"}))
    assert "within 1.5 min" in told and "13.24 switches / min" in told


def test_rows_say_what_it_is_about():
    evidence = {"certificate": by_hand(SQUARE, (20, 10)).to_json()}
    assert [name for name, _ in evidence_rows(evidence)] == ["certificate", "", ""]
    texts = [text for _, text in evidence_rows(evidence)]
    assert texts[1:] == ["initial the middle, target a ball", "rate 1000"]


def test_the_file_keeps_it_and_reports_tell_it(tmp_path):
    policy = full()
    certificate = by_hand(policy.domain, (8,) * policy.domain.n)
    policy.with_evidence(certificate=certificate.evidence()).save(tmp_path / "p.cap")
    loaded = Policy.load(tmp_path / "p.cap")
    assert report(loaded)["evidence"]["certificate"] == certificate.evidence()


def spoiled():
    """Yield the name of a damage, and the evidence that has it."""
    whole = by_hand(SQUARE, (20, 10)).evidence()
    longer = by_hand(SQUARE, (20, 11)).evidence()["map"]["runs"]
    for keys, value in (
        (("arrival",), 1.01),
        (("open",), None),
        (("within",), None),
        (("within",), "soon"),
        (("within",), -1.0),
        (("switch_rate",), True),
        (("ripple",), [[0, 1]]),
        (("ripple", 0), [0, "1"]),
        (("ripple", 1), [0, 1, 2]),
        (("states",), ["level"]),
        (("units",), [None, ""]),
        (("refuted",), {}),
        (("refuted", 0), [0.9, 1.4]),
        (("refuted", 0, "state"), [0.9]),
        (("refuted", 0, "failure"), 3),
        (("refuted", 0, "failure"), "\x1b[31m"),
        (("stopped",), None),
        (("conditions",), []),
        (("conditions", "time_unit"), "fortnight"),
        (("map",), None),
        (("map",), []),
        (("map", "counts"), [20]),
        (("map", "counts"), [200]),
        (("map", "counts"), [-20, -10]),
        (("map", "counts"), [20.0, 10]),
        (("map", "counts"), [10, 10]),
        (("map", "counts"), [2**20, 2**20]),
        (("map", "runs"), 3),
        (("map", "runs"), "?"),
        (("map", "runs"), longer),
        (("map", "runs"), "CQ==" * 100_000),
    ):
        data = copy.deepcopy(whole)
        place = data
        for key in keys[:-1]:
            place = place[key]
        place[keys[-1]] = value
        yield pytest.param(data, id=f"{'.'.join(map(str, keys))}={str(value)[:20]}")


def test_evidence_has_a_map_or_none():
    assert is_evidence("certificate", by_hand(SQUARE, (20, 10)).evidence())
    assert is_evidence("certificate", by_hand(SQUARE, (20, 10)).to_json())
    assert is_evidence("certificate", complete(SQUARE, (20, 10)).evidence())


@pytest.mark.parametrize("data", list(spoiled()))
def test_what_is_no_certificate_is_refused(data, tmp_path):
    with pytest.raises(ProblemError, match="`certificate` must be what to_json"):
        full().with_evidence(certificate=data)
    path = tmp_path / "p.cap"
    full().with_evidence(certificate=by_hand(SQUARE, (20, 10)).evidence()).save(path)
    rewrite(path, lambda document, arrays: document["evidence"].update(certificate=data))
    refuse(path, "its evidence 'certificate' is of another kind")
