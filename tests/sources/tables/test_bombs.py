"""Files that would take much time or memory: refused, or read, in neither."""

import json
import time
import tracemalloc

import pytest

from capsyn.errors import ProblemError
from capsyn.sources.grid_files import read_table

MANY = 40_000
DEEP = "[" * 900 + "]" * 900


@pytest.mark.parametrize(
    "text",
    [
        "x,v" + "_" * MANY + ",u\n0,1,2\n",
        "x,v " + "1" * MANY + ",u\n0,1,2\n",
        "x v " + "a [" * MANY + "\n0 1 2\n",
        "x,v,u\n0,1," + "1" * MANY + "x\n",
        "x,v,u\n0," + "1" * MANY + "x,2\n",
        "x" + ",x" * MANY + "\n0" + ",0" * MANY + "\n",
        '"' + '""' * MANY + "\n0,0\n",
        "#PERMISSIVE\n" + "\n" * MANY + "0,1\n",
        "#PERMISSIVE\n" + "#BEGIN " * MANY + "\n0,1\n",
        "(0)" + " " * MANY + "x\n",
        "(0) = a\n(1)" + " , " * MANY + "x\n",
        "(" * MANY,
        "(" + "0," * MANY + "0)=a\n",
        "#SCOTS:v0.2\n" + "# comment\n" * MANY,
        "#SCOTS:v0.2\n" + " " * MANY,
        '{"type": "' + '\\"' * MANY,
        '[{"s": {"x": 0}, "c": [{"origin": ' + DEEP + '}]}, {"s": 1}]',
        '[{"s": ' + DEEP + ', "c": 0}]',
        '[{"s": {"x": 0}, "c": ' + DEEP + "}]",
        '{"type": ' + DEEP + "}",
        '{"type": "state->regressor", "representation": "map", "statevars": ' + DEEP + "}",
        "[" + "{}," * MANY + "{}]",
        json.dumps([{"s": {"x": 10**k}, "c": [{"labels": ["a"]}]} for k in range(15)]),
    ],
    ids=range(23),
)
def test_bombs_take_neither_time_nor_memory(text, tmp_path):
    path = tmp_path / "bomb"
    path.write_text(text)
    tracemalloc.start()
    start = time.process_time()
    with pytest.raises(ProblemError) as error:
        read_table(path)
    took, peak = time.process_time() - start, tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "\n" not in str(error.value) and len(str(error.value)) < 600
    assert took < 10 and peak < 50e6  # of work that grows with the square it takes minutes
