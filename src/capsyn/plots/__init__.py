"""Pictures of policies, trajectories and automata; every function returns the Axes it drew on."""

from capsyn.plots.automaton import plot_automaton, save_automaton
from capsyn.plots.certificate import plot_certificate, save_certificate_plot
from capsyn.plots.curve import plot_curve, save_curve_plot
from capsyn.plots.figure import (
    check_format,
    frame,
    literal,
    outline_width,
    quantity,
    rectangles,
    reproducible,
    save_figure,
)
from capsyn.plots.policy import plot_policy, save_policy_plot
from capsyn.plots.trajectory import plot_trajectory, save_trajectory_plot
from capsyn.policies.colors import Look, symbol_colors, symbol_looks

__all__ = [
    "Look",
    "check_format",
    "frame",
    "literal",
    "outline_width",
    "plot_automaton",
    "plot_certificate",
    "plot_curve",
    "plot_policy",
    "plot_trajectory",
    "quantity",
    "rectangles",
    "reproducible",
    "save_automaton",
    "save_certificate_plot",
    "save_curve_plot",
    "save_figure",
    "save_policy_plot",
    "save_trajectory_plot",
    "symbol_colors",
    "symbol_looks",
]
