"""A study of alphabets as a search may leave it, for what shows studies."""

from __future__ import annotations

import math

import numpy as np

from capsyn.alphabets.judged import Judged
from capsyn.alphabets.study import AlphabetStudy
from capsyn.modelling.alphabet import Alphabet


def motor_study() -> AlphabetStudy:
    """Return a study of a motor: two chosen alphabets, and others beside them."""
    three = Alphabet([-5.0, 0.0, 5.0], ["-5", "off", "5"])
    two, even = Alphabet([-5.0, 5.0]), Alphabet([-5.0, -1.0, 5.0])
    sizes = {"cells": 450, "solves": 2700, "nodes": 300, "bytes": 900}
    figures = {"cost": 555.0, "switches": 3.25}
    lost = dict.fromkeys(("objective", "low", "high"), math.inf)
    rows = (
        Judged(2, "chosen", two, 804.0, 784.0, 824.0, 0.98, 0.96, 0.99, figures, **sizes),
        Judged(2, "uniform", two, 904.0, 884.0, 924.0, 0.98, 0.96, 0.99, figures, **sizes),
        Judged(3, "chosen", three, 555.0, 535.0, 575.0, 1.0, 0.99, 1.0, figures, **sizes),
        Judged(3, "random", even, 955.0, 935.0, 975.0, 0.9, 0.89, 0.92, figures, tried=5),
        Judged(3, "uniform", even, **lost, success=0.5, success_low=0.4, success_high=0.6, lost=12),
    )
    return AlphabetStudy(
        problem="motor",
        objective={"cost": 1.0, "time": 0.02},
        count=3,
        alphabet=three,
        table=rows,
        candidates=Alphabet(np.linspace(-5, 5, 21)),
        searched=1234,
        fresh=1000,
        prices={"5": 3.0},
    )
