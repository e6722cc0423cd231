"""The paper's pendulum (Section V): figures 3 and 4, Lyapunov, and swing-up beyond the paper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.automata.automaton import Automaton
from capsyn.modelling.transcription import user_program
from capsyn.paper.cases import RATE, Row, successes
from capsyn.paper.figures import (
    draw_derivative_signs,
    draw_dwell_tradeoff,
    draw_layers,
    halves,
)
from capsyn.plots.automaton import plot_automaton
from capsyn.plots.figure import new_figure
from capsyn.plots.policy import plot_policy
from capsyn.policies.policy import Policy, cell_tree
from capsyn.problems import cart_pendulum
from capsyn.verification.agreement import agreement
from capsyn.verification.lyapunov import lyapunov, lyapunov_grid
from capsyn.verification.monte_carlo import monte_carlo

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DWELL_TIMES = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)


def figure_3(policy: Policy) -> Figure:
    """Return Fig. 3: the layers of the two-symbol policy, and its finite state machine."""
    figure = new_figure(13, 5)
    upper, lower = halves(figure, False, (3, 2))
    draw_layers(policy, upper.subplots(1, cell_tree(policy).max_level + 1))
    plot_automaton(Automaton.of(policy), lower.subplots())
    return figure


def figure_4a(policy: Policy) -> Figure:
    """Return Fig. 4a: the four-symbol policy, and its finite state machine."""
    figure = new_figure(11, 4.5)
    left, right = halves(figure, True, (3, 2))
    plot_policy(policy, ax=left.subplots())
    plot_automaton(Automaton.of(policy), right.subplots())
    return figure


def compare_with_law(policy: Policy) -> list[Row]:
    """Return how the two-symbol policy compares with the bang-bang law."""
    agreed = agreement(policy, 200_000, controller=_bang_bang)
    return [
        Row(
            "two-symbol policy against the bang-bang law of [20]",
            "structurally identical",
            f"{agreed.share:.2%} of random states, 100 % above the finest level"
            if (agreed.level_agreeing[:-1] == agreed.level_states[:-1]).all()
            else f"{agreed.share:.2%} of random states",
            "u = -5 sign(E omega cos theta); the footnote's plus sign belongs to a model with the "
            "opposite input sign",
        )
    ]


def _bang_bang(states: np.ndarray) -> np.ndarray:
    """Return symbols (B,) of the analytical law: 1 (-5 m/s^2) where E omega cos theta > 0."""
    theta, omega = states.T
    program = user_program("energy", cart_pendulum.energy, (("x", 2),), (("energy", 1),))
    energy = program.evaluate(states.T)[0][0]
    return (energy * omega * np.cos(theta) > 0).astype(int)


def prove(pendulums: Sequence[Policy]) -> tuple[Figure, list[Row]]:
    """Return Fig. 4b, the sign of dV/dt, and what is proved about it."""
    rows = []
    figure = new_figure(6.4, 3.6 * len(pendulums) / 2 + 1.8)
    axes = figure.subplots(len(pendulums), 1, sharex=True)
    for policy, ax in zip(pendulums, axes):
        grid = lyapunov_grid(policy, cart_pendulum.energy_error, 0.01)
        x_axis, y_axis = grid.axes
        draw_derivative_signs(x_axis, y_axis, grid.signs, policy.space, ax)
        for theta in (np.pi / 2, 3 * np.pi / 2):  # between the grid's points
            ax.axvline(theta, color="#7F7F7F", linewidth=0.8)
        ax.set_title(policy.name, loc="left", fontsize="medium")
        if policy is not pendulums[0]:
            ax.get_legend().remove()
        shares = grid.shares
        rows.append(
            Row(
                f"dV/dt of V = |E| on the 0.01 grid, {policy.name}",
                "< 0 but for lines and scattered points on the switching manifold",
                f"< 0 {shares['negative']:.2%}, = 0 {shares['zero']:.2%}, "
                f"> 0 {shares['positive']:.2%}",
                "the rest lies in finest cells that a switching surface crosses",
            )
        )
        proof = lyapunov(policy, cart_pendulum.energy_error)
        rows.append(
            Row(
                f"dV/dt proved by intervals, {policy.name}",
                "",
                f"<= 0 on {proof.proved:.3%} of the volume, < 0 on {proof.negative:.3%}; > 0 on "
                f"{proof.violated:.3%}, undecided {proof.undecided:.3%}",
                f"{len(proof.violated_cells):,} cells with a witness, "
                f"{int(proof.violated_cells.boundary.sum()):,} of them finest boundary cells",
            )
        )
    return figure, rows


def swing_up(
    pendulums: Sequence[Policy], trials: int, threads: int | None
) -> tuple[Figure, list[Row]]:
    """Return success against minimum dwell time, and the swing-up trials."""
    rows, tried = [], {}
    tests: dict[str, Any] = {"duration": 20.0, "rate": RATE, "within": 10.0, "hold": 5.0}
    for policy in pendulums:
        tried[policy.name] = [
            monte_carlo(policy, trials, **tests, min_dwell=dwell, threads=threads)
            for dwell in (DWELL_TIMES if policy is pendulums[0] else DWELL_TIMES[:1])
        ]
        result = tried[policy.name][0]
        rows.append(
            Row(
                f"swing-up, {policy.name}",
                "global inversion",
                f"{successes(result)}, slowest {np.nanmax(result.arrived):.2f} s, "
                f"{np.mean(result.switches / result.times):.0f} switches/s",
                "|E| within 5 % of 2 mu g h in 10 s, and so over the last 5 of 20 s, at 1 kHz",
            )
        )
    runs = tried[pendulums[0].name]
    figure = new_figure(6.4, 3.6)
    draw_dwell_tradeoff(
        np.array(DWELL_TIMES),
        np.array([run.success_rate for run in runs]),
        np.array([run.low for run in runs]),
        np.array([run.high for run in runs]),
        np.array([np.mean(run.switches / run.times) for run in runs]),
        figure.add_subplot(),
    )
    whole = [time for time, run in zip(DWELL_TIMES, runs) if run.success.all()]
    what = "longest minimum dwell time without a failure"
    ours = f"{max(whole):g} s of those tried" if whole else "none of those tried"
    rows.append(Row(what, "", ours, "see dwell-time.pdf"))
    return figure, rows
