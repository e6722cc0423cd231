"""Tails on the command line."""

import json

import pytest

from capsyn import Policy, problems
from capsyn.modelling.transcription import transcribe
from support.processes.command_line import capsyn, error_of


def made(tmp_path, *options):
    """Return the policy that synth makes of cart-pole, of one cell."""
    path = tmp_path / "pole.cap"
    small = ("--partitions", "1", "--max-level", "0", "--json")
    out, _ = capsyn("synth", "cart-pole", *small, "-o", path, *options)
    assert json.loads(out)["horizon"] == Policy.load(path).horizon
    return Policy.load(path)


@pytest.mark.parametrize(
    ("options", "tail", "horizon"),
    [
        ((), "riccati", 0.1),
        (("--tail", "riccati:3"), "riccati:3", 0.2),
        (("--tail", "riccati:3", "--horizon", "0.25"), "riccati:3", 0.25),
        (("--tail", "none", "--horizon", "0.6"), None, 0.6),
        (("--tail", "none"), None, 0.1),
    ],
)
def test_synth_takes_a_tail_and_the_horizon_that_it_proposes(tmp_path, options, tail, horizon):
    policy = made(tmp_path, *options)
    assert policy.horizon == pytest.approx(horizon, abs=0.01)
    wanted = transcribe(problems.get("cart-pole").replace(tail=tail)).terminal_cost
    states = policy.domain.sample(20, 0)
    for own, other in zip(policy.model.terminal_cost.evaluate(states.T), wanted.evaluate(states.T)):
        assert own == pytest.approx(other)


def test_what_is_no_tail_is_one_line():
    line = error_of("synth", "cart-pole", "--tail", "lqr")
    wanted = "'riccati', 'riccati:EFFORT', 'fit' or a function"
    assert line == f"error: `tail` must be {wanted}; got 'lqr'\n"
    for tail in ("riccati", "fit"):
        line = error_of("synth", "cart-pendulum", "--tail", tail)
        assert line.startswith("error: `tail` needs a `running_cost`")
