"""Commands that judge and draw policies which are told exogenous inputs."""

import json

import pytest

from capsyn import Box, Policy
from support.processes.command_line import capsyn, error_of
from support.relays import relay

V = """
import casadi as ca

features = {"error": lambda x, w: x[0] - w[0]}


def V(x, w):
    return ca.fmax((x[0] - w[0]) ** 2, 0.125**2)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("told")
    (folder / "V.py").write_text(V)
    relay(
        lambda x, u, w: [u[0]],
        Box([-1.0], [1.0], names=["x"]),
        lambda z: (z[:, 0] > z[:, 1]).astype(int),
        partitions=[32, 16],
        exogenous=Box([-0.5], [0.5], names=["setpoint"]),
    ).save(folder / "p.cap")
    return folder


def test_a_proof_is_for_every_setpoint(folder):
    arguments = ("verify", "p.cap", "--lyapunov", "V.py:V", "--grid", "0.1,0.25", "--save")
    out, _ = capsyn(*arguments, "--require-proved", "1", cwd=folder)
    assert "for V = V.py:V and every constant setpoint in [-0.5, 0.5]" in " ".join(out.split())
    kept = Policy.load(folder / "p.cap").evidence["lyapunov"]
    assert kept["exogenous"] == "setpoint in [-0.5, 0.5]" and kept["grid"]["states"] == [21, 5]
    assert "every constant setpoint" in " ".join(capsyn("info", "p.cap", cwd=folder)[0].split())


def test_sliding_faces_are_told_with_the_exogenous_inputs(folder):
    out, _ = capsyn("automaton", "p.cap", cwd=folder)
    assert "slides on    x = " in out and ", setpoint in [" in out
    data = json.loads(capsyn("automaton", "p.cap", "--json", cwd=folder)[0])
    assert (data["states"], data["exogenous"]) == (["x"], ["setpoint"])
    assert {face["axis"] for face in data["switching"]["sliding_faces"]} == {0}


def test_a_plot_takes_exogenous_inputs(folder):
    out, _ = capsyn("plot", "p.cap", "-o", "p.png", cwd=folder)
    assert "wrote p.png" in out
    wrong = error_of("plot", "p.cap", "-o", "p.png", "--at", "setpoint=0.1", cwd=folder)
    assert "states and exogenous inputs outside the plane (there is none)" in wrong


def test_features_are_functions_of_states_and_exogenous_inputs(folder):
    out, _ = capsyn("compress", "p.cap", "--features", "V.py", "-o", "t.cap", cwd=folder)
    assert "wrote t.cap" in out
    tree = Policy.load(folder / "t.cap")
    assert tree.cells.features.names == ("error",) and tree.exogenous.names == ("setpoint",)


def test_switches_are_counted_at_drawn_setpoints(folder):
    arguments = ("switching", "p.cap", "--trials", "8", "--duration", "1", "--rate", "50")
    (found,) = (json.loads(capsyn(*arguments, "--json", cwd=folder)[0]),)
    assert found["switches"] > 0
