"""Options of commands: dataclasses, flattened for Typer, that say what the functions say."""

import dataclasses
import inspect
from dataclasses import dataclass
from typing import Annotated

import typer

from capsyn import Alphabet, Box, SsacSettings, problems, synthesize
from capsyn.cli.better.tune import tune
from capsyn.cli.evidence import KINDS, VerifyOptions, verify
from capsyn.cli.loop import ControllerTexts, LoopTexts
from capsyn.cli.making.simulate import SimulateOptions, simulate
from capsyn.cli.making.synth import SettingsOptions, SubdivisionOptions
from capsyn.cli.options import SwitchingOptions, assignments, flat, listed, option, region
from capsyn.simulation.options import LoopOptions


@dataclass(frozen=True)
class Pair:
    first: int = option("", default=1)
    last: Annotated[int, typer.Option()] = 2


@dataclass(frozen=True)
class More(Pair):
    middle: int = option("", default=3, before="last")
    also: int = option("", default=4, before="last")


def test_a_dataclass_of_options_is_flattened_in_its_place():
    values = []

    @flat
    def command(file: str, pair: More, end: bool = False) -> None:
        values.append((file, pair, end))

    parameters = inspect.signature(command).parameters
    assert list(parameters) == "file first middle also last end".split()
    assert parameters["also"].default == 4 and parameters["file"].default is inspect.Parameter.empty
    command(file="f", first=5, middle=6, also=7, last=8, end=True)
    assert values == [("f", More(first=5, last=8, middle=6, also=7), True)]


def test_blanks_in_lists_mean_nothing():
    assert listed(" a, b ,c") == ["a", "b", "c"]
    assert assignments("--at", ["a = 1", " b=2 "]) == {"a": "1", "b": "2"}
    assert region("--stay-in", "x1 = -1 : 1, x2 = 0:2", ["x1", "x2"]) == Box(
        [-1, 0], [1, 2], names=["x1", "x2"]
    )
    found = SwitchingOptions(hold=["a = 1, b= 2"], forbid=["a : b, b:a"]).of(
        problems.get("cart-pendulum").replace(alphabet=Alphabet([-1, 1], names=["a", "b"]))
    )
    assert found.hold == {"a": 1.0, "b": 2.0} and found.forbidden == (("a", "b"), ("b", "a"))


def defaults(kind):
    return {field.name: field.default for field in dataclasses.fields(kind)}


def test_commands_have_the_options_of_closed_loops():
    loop, texts = defaults(LoopOptions), defaults(LoopTexts)
    plain = "duration rate min_dwell outside outside_at_once seed backend threads".split()
    assert [texts[name] for name in plain] == [loop[name] for name in plain]
    as_texts = {"model", "parameter", "disturbance", "noise", "delay", "target", "exogenous"}
    assert {name for name in as_texts if texts[name] is not None} == set()
    assert set(texts) == {*plain} | as_texts | {"tolerance"}
    more = defaults(ControllerTexts)
    assert set(more) == {*texts} | {"online", "background", "track", "avoid", "stay_in", "cost"}
    # the number of steps is the library's to choose
    assert set(loop) - {*plain} - as_texts == {
        "parameters",
        "stop_at_target",
        "substeps",
        "executor",
        "avoid",
        "stay_in",
        "costs",
    }
    assert defaults(SimulateOptions)["stop_at_target"] is loop["stop_at_target"]
    for command, own in ((simulate, more), (verify, more), (tune, texts)):
        assert set(own) <= set(inspect.signature(command).parameters)


def test_kinds_of_evidence_name_options():
    fields = defaults(VerifyOptions)
    for kind in KINDS:
        assert {kind.name, kind.requirement, *kind.own} <= set(fields)


def test_synth_has_the_defaults_of_synthesize():
    said = inspect.signature(synthesize).parameters
    for name, value in defaults(SubdivisionOptions).items():
        assert said[name].default == value, name
    assert set(defaults(SettingsOptions)) <= set(defaults(SsacSettings))
