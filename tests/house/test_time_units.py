"""A model that counts time in minutes: no second is said anywhere, and its numbers are minutes."""

import dataclasses
import json
import re
import zipfile

import numpy as np
import pytest

from capsyn import (
    Box,
    Policy,
    Problem,
    SsacSettings,
    explore,
    export,
    lyapunov,
    monte_carlo,
    online_controller,
    simulate,
    subdivide,
    synthesize,
)
from capsyn.automata.automaton import Automaton
from capsyn.errors import ProblemError
from capsyn.modelling.time_unit import NAMES, PER_SECOND, from_seconds, to_seconds
from capsyn.plots.trajectory import plot_trajectory
from capsyn.policies.report import report
from capsyn.sources.table import Table
from support.explorer.page import json_of
from support.processes.command_line import capsyn, error_of

SECONDS = re.compile(r"(?<![\w'’.&-])(s|ms|k?Hz)(?![\w(])|per.seconds?\b|\bseconds\b")
"""What a text says of seconds; not the end of "policy's", and not the second of two."""


def said(text):
    """Return what a text says of seconds, with what stands around it."""
    return [text[max(0, m.start() - 40) : m.end() + 10] for m in SECONDS.finditer(text)]


def test_what_is_looked_for_is_found():
    for text in ("in 3 s", "time [s]", "[1/s]", "2 per second", "at 5 ms", "1 kHz, 3 Hz", '"s"'):
        assert said(text), text
    assert not said("the policy's dwell of 5 min, 1/min, s_1, was")


PROBLEM = """
import capsyn
problem = capsyn.Problem(
    name="room", dynamics=lambda x, u: [(18 - x[0]) / 40 + u[0] / 10],
    domain=capsyn.Box([14], [26], names=["temperature"], units=["degC"]),
    alphabet=capsyn.Alphabet([0, 8], names=["off", "heat"], inputs=["power"], units=["kW"]),
    default=0, horizon=30.0, running_cost=lambda x: (x[0] - 21) ** 2, min_dwell=5.0,
    target=capsyn.Ball([21], 1.0), settings=capsyn.SsacSettings(sample_time=0.5, rule="steepest"),
    outside=0, max_level=2, time_unit="min", outside_at_once=True,
)
"""
"""A room with a heater, in minutes."""


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """Return a folder with the problem, ``room.py``, and its policy, ``room.cap``."""
    folder = tmp_path_factory.mktemp("room")
    (folder / "room.py").write_text(PROBLEM)
    (folder / "V.py").write_text("def V(x): return (x[0] - 21) ** 2\n")
    out, _ = capsyn("synth", folder / "room.py", "-o", folder / "room.cap", cwd=folder)
    last = out.splitlines()[-1]
    assert re.fullmatch(r"wrote .*room.cap in \d+\.\d\d s", last)  # of the wall's clock
    told = out.replace(last, "")
    assert said(told) == [] and "horizon 30.0 min in" in told
    assert "outside      off, at once; minimum dwell 5 min" in told
    return folder


def test_the_file_carries_the_unit(room):
    policy = Policy.load(room / "room.cap")
    assert (policy.time_unit, policy.min_dwell, policy.horizon) == ("min", 5.0, 30.0)
    assert policy.outside_at_once is True


def test_info_and_automaton(room):
    for command in ("info", "automaton"):
        out, _ = capsyn(command, "room.cap", cwd=room)
        assert said(out) == []
        assert "per minute from evenly spread states" in out.replace("\n", " ")
    out, _ = capsyn("automaton", "room.cap", cwd=room)
    assert "rate [1/min]" in out
    out, _ = capsyn("automaton", "room.cap", "--json", cwd=room)
    assert json.loads(out)["time_unit"] == "min" and said(out) == []
    data = report(Policy.load(room / "room.cap"))
    assert data["time_unit"] == "min" and data["min_dwell"] == 5.0


def test_simulate(room):
    run = ("simulate", "room.cap", "--x0", "16", "--duration", "30")
    out, _ = capsyn(*run, cwd=room)
    assert said(out) == []
    assert "in 30 min, ended: time" in out and re.search(r"target first at [\d.]+ min", out)
    out, _ = capsyn(*run, "--json", cwd=room)
    data = json.loads(out)
    assert data["time_unit"] == "min" and data["duration"] == 30 and said(out) == []
    trajectory = simulate(Policy.load(room / "room.cap"), [16.0], 30)
    assert len(trajectory.times) == 61  # two samples a minute
    assert "60 samples, 30 min, ended" in repr(trajectory)
    assert trajectory.to_json()["time_unit"] == "min"
    switched = np.flatnonzero(np.diff(trajectory.symbols)) + 1
    assert len(switched) > 1 and np.diff(trajectory.times[switched]).min() >= 5
    # 30 minutes of dx = (18 - x) / 40 + 0.8 up to the first switch
    k = switched[0]
    warm = 50 - 34 * np.exp(-trajectory.times[k] / 40)
    np.testing.assert_allclose(trajectory.states[k, 0], warm, atol=1e-7, rtol=0)


def test_verify(room):
    options = "--monte-carlo 40 --duration 60 --hold 10 --delay 0.5:1 --target temperature=19:24"
    out, _ = capsyn("verify", "room.cap", *options.split(), "--lyapunov", "V.py:V", cwd=room)
    assert said(out) == []
    for text in (
        "within 60 min, and stay there the last 10 min",
        "rate 2 1/min, min dwell 5 min, outside off, outside at once",
        "delay 0.5 to 1 min",
        "per minute",
        " min until the target",
    ):
        assert text in out, text
    assert re.search(r"failed from .*delay [\d.]+ min", out) and "grows at" in out
    assert re.search(r"--delay [\d.]+ --duration 60.0", out) and "at-once" not in out
    out, _ = capsyn("verify", "room.cap", *options.split(), "--no-outside-at-once", cwd=room)
    assert re.search(r"again .* --no-outside-at-once", out) and "outside at once" not in out
    out, _ = capsyn("verify", "room.cap", *options.split(), "--json", cwd=room)
    data = json.loads(out)["monte_carlo"]
    assert data["conditions"]["time_unit"] == "min" and said(out) == []
    assert data["switches_per_minute"]["max"] <= 0.2  # a dwell time of 5
    assert data["time_to_target"]["max"] <= 60


def test_evidence_in_a_file(room, tmp_path):
    policy = Policy.load(room / "room.cap")
    proof = lyapunov(policy, lambda x: (x[0] - 21) ** 2).to_json()
    trials = monte_carlo(policy, 20, duration=60).to_json()
    assert proof["time_unit"] == "min"
    policy.with_evidence(monte_carlo=trials, lyapunov=proof).save(tmp_path / "p.cap")
    out, _ = capsyn("info", tmp_path / "p.cap", "--quick")
    assert said(out) == [] and "within 60 min" in out


@pytest.mark.parametrize("kind", ["csv", "json", "svg"])
def test_files_of_trajectories(kind, room, tmp_path):
    path = tmp_path / f"t.{kind}"
    capsyn("simulate", "room.cap", "--duration", "5", "-o", path, cwd=room)
    if kind != "svg":
        assert said(path.read_text()) == []


def test_labels_of_plots(room):
    figure = pytest.importorskip("matplotlib.figure").Figure()
    trajectory = simulate(Policy.load(room / "room.cap"), [16.0], 30)
    axes = plot_trajectory(trajectory, figure.subplots(2))
    assert axes[-1].get_xlabel() == "time [min]"
    seconds = dataclasses.replace(trajectory, time_unit="s")
    assert plot_trajectory(seconds, figure.subplots(2))[-1].get_xlabel() == "time [s]"


def test_the_page_outside_its_code(room, tmp_path):
    text = explore(Policy.load(room / "room.cap"), tmp_path / "page.html").read_text()
    visible = re.sub(
        r"<style>.*?</style>|<script type=\"module\">.*?</script>", "", text, flags=re.S
    )
    visible = re.sub(r'content="[^"]*"|(?<=id="data">)[^<]*', "", visible)
    visible += json.dumps(json_of(text), separators=(",", ":"))
    assert said(visible) == []
    assert '["horizon","30 min"]' in visible and '["sample time","0.5 min"]' in visible
    assert '["outside","off, at once"]' in visible and '["least dwell","5 min"]' in visible
    assert '"time_unit":"min"' in visible and '"outside_at_once":true' in visible


EXPORTS = {
    "c": r"(ticks of|every) \S+ s|5\.0 min = 300\.0 s",  # ticks; and both
    "structured-text": None,
    "verilog": r"\d+ Hz|at least 300 s between",  # its clock, by which the minutes are counted
    "fmu": r'unit="s"|name="s"| s="1"',  # time of FMI is in seconds
    "python": None,
    "javascript": None,
    "dot": None,
    "json": None,
}
"""Targets, and what they say of seconds where they mean them."""


def texts_of(path):
    """Yield the texts in a file of an export; of a unit those that are in it."""
    if path.suffix == ".fmu":
        with zipfile.ZipFile(path) as archive:
            names = (name for name in archive.namelist() if name.endswith((".xml", ".c")))
            yield from (archive.read(name).decode() for name in names)
    elif "schema" not in path.name:
        yield path.read_text()


@pytest.mark.parametrize("to", EXPORTS)
def test_exports(to, room, tmp_path):
    policy, meant = Policy.load(room / "room.cap"), EXPORTS[to]
    texts = [text for path in export(policy, to, tmp_path) for text in texts_of(path)]
    assert [said(re.sub(meant, "", text) if meant else text) for text in texts] == [[]] * len(texts)
    assert sum("Least time between switches: 5.0 min" in text for text in texts) >= 2


def test_readings_of_the_command_line_are_in_minutes(room):
    data = json.loads(capsyn("export", "room.cap", "--to", "json", "-o", "out", "--dwell", "2",
                             "--no-outside-at-once", "--json", cwd=room)[0])  # fmt: skip
    (path,) = (f for f in data["files"] if f.endswith("room.json"))
    document = json.loads((room / path).read_text())
    assert (document["time_unit"], document["min_dwell"]) == ("min", 2.0)
    assert document["at_once"] == [2]


def test_units_do_not_mix(room):
    policy = Policy.load(room / "room.cap")
    seconds = dataclasses.replace(policy, time_unit="s")
    for one, other in ((policy, seconds), (seconds, policy)):
        told = f"`model` must count time in {one.time_unit} like the controller; got"
        with pytest.raises(ProblemError, match=told):
            simulate(one, [16.0], 30, model=other)
        with pytest.raises(ProblemError, match="`default` must count time in"):
            online_controller(one, default=other)
    online = online_controller(policy)
    assert "horizon 30 min" in repr(online) and simulate(online, [16.0], 3).time_unit == "min"
    with pytest.raises(ProblemError, match="`model` must count time in min"):
        simulate(online, [16.0], 30, model=seconds)
    function = simulate(lambda t, x: np.zeros((len(x), 1)), [16.0], 3, 2, model=policy)
    assert function.time_unit == "min"


def test_other_sources_take_a_unit(tmp_path):
    table = Table.of([0.0], [1.0], [0, 1, 1, 0], [0, 1])
    made = table.policy(min_dwell=3.0, time_unit="h", outside=1, outside_at_once=True)
    assert (made.time_unit, made.min_dwell, made.outside_at_once) == ("h", 3.0, True)
    cells = subdivide(lambda x: (x[:, 0] > 0).astype(int), Box([-1], [1]), 2, time_unit="us")
    assert cells.time_unit == "us"
    for wrong in (
        lambda: table.policy(time_unit="hours"),
        lambda: subdivide(lambda x: 1 / 0, Box([-1], [1]), 2, time_unit=60),
    ):
        with pytest.raises(
            ProblemError, match="`time_unit` must be one of 'ns', 'us', 'ms', 's', 'min'"
        ):
            wrong()
    (tmp_path / "t.csv").write_text("x,symbol\n0,0\n1,1\n2,1\n")
    capsyn("import", "t.csv", "--time-unit", "h", "--outside", "1", "--outside-at-once",
           cwd=tmp_path)  # fmt: skip
    made = Policy.load(tmp_path / "t.cap")
    assert (made.time_unit, made.outside, made.outside_at_once) == ("h", 1, True)
    assert "`time_unit` must be one of" in error_of(
        "import", "t.csv", "--time-unit", "m", cwd=tmp_path
    )


def test_synthesis_does_not_look_at_the_unit():
    problem = Problem(
        "p", lambda x, u: [u[0] - x[0]], Box([-1], [1]), [-1, 1], 0, 1.0,
        running_cost=lambda x: x[0] ** 2, settings=SsacSettings(steps=4), max_level=2,
    )  # fmt: skip
    one, other = (synthesize(problem.replace(time_unit=unit)) for unit in ("s", "d"))
    assert (one.cells.entries == other.cells.entries).all() and other.time_unit == "d"
    assert synthesize(problem, outside=0, outside_at_once=True).outside_at_once
    assert Automaton.of(other).to_json()["switching"] == Automaton.of(one).to_json()["switching"]


@pytest.mark.parametrize("unit", PER_SECOND)
def test_units_are_named_and_convert_both_ways(unit):
    assert unit in NAMES
    for time in (1.0, 0.1, 5.0, 1e-3, 7e5):
        there = to_seconds(time, unit)
        assert from_seconds(there, unit) == pytest.approx(time, rel=4e-16)
    assert to_seconds(5.0, "min") == 300.0 and to_seconds(0.25, "us") == 2.5e-7
