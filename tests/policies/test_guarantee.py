"""What a tree guarantees: its sentence, and what makes no sense."""

import json

import numpy as np
import pytest

from capsyn.errors import ProblemError
from capsyn.policies.guarantee import Guarantee
from support.split_trees import SOURCE, guarantee

NAN = float("nan")


@pytest.mark.parametrize(
    "known",
    [
        {"mode": "other"},
        {"mode": []},
        {"controller": "other"},
        {"controller": None},
        {"source": "0" * 63},
        {"source": "G" * 64},
        {"source": None},
        {"level": -1},
        {"level": 64},
        {"level": 1.0},
        {"level": True},
        {"changed": -0.1},
        {"changed": 1.1},
        {"changed": NAN},
        {"changed": "0"},
        {"changed": True},
        {"states": -1},
        {"states": 1.0},
        {"states": 2**53, "controller": "ssac"},
        {"states": 5},
        {"controller": "ssac"},
        {"states": 5, "agreeing": 6, "controller": "ssac"},
        {"agreeing": -1},
        {"target": 1.5},
        {"target": "0.5"},
        {"target": NAN},
    ],
)
def test_guarantees_that_make_no_sense_are_refused(known):
    with pytest.raises(ProblemError) as caught:
        Guarantee(**{"mode": "exact", "source": SOURCE} | known)
    assert "\n" not in str(caught.value)


def test_guarantees_in_a_sentence():
    assert guarantee().text == "equal to the policy in every cell (proved)"
    assert np.isnan(guarantee().agreement)
    cut = guarantee(level=2, changed=0.125).text
    assert "policy cut off at level 2 in every cell (proved); another symbol" in cut
    assert cut.endswith("in 12.50% of the volume")
    free = guarantee("freedom", controller="ssac", states=200, agreeing=199)
    assert free.agreement == 0.995
    assert "test points agreed, and a symbol seen in the cell elsewhere (proved);" in free.text
    assert free.text.endswith(
        "agrees with sSAC at 99.50% of 200 random states (97.24% to 99.988% with 95% confidence)"
    )
    linear = guarantee("linear", changed=0.5, controller="policy", states=10, agreeing=5)
    assert linear.text.startswith("another symbol than the policy's in 50.00% of the volume (est")
    assert "proved" not in linear.text and "agrees with the policy at 50.00%" in linear.text
    assert Guarantee(**json.loads(json.dumps(free.to_json()))) == free
