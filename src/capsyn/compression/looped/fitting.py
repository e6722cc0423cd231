"""Trees with oblique splits, fitted to where the loops of a policy go, and their own."""

from __future__ import annotations

import numpy as np

from capsyn.compression.fitted.oblique import fine_lattice, to_lattice
from capsyn.compression.fitted.plane_tree import Node, best_label, grow
from capsyn.compression.fitted.surface import Samples, draw_samples, find_surface
from capsyn.compression.judge import Judge
from capsyn.compression.looped.choice import Candidate, LoopChoice
from capsyn.compression.looped.growing import growing, pruning
from capsyn.compression.looped.loops import Visits
from capsyn.compression.rows import tree_of_rows
from capsyn.policies.file import content_hash
from capsyn.policies.guarantee import Guarantee
from capsyn.random_streams import derived_seed, stream

FITTING = 9
"""Purpose of what is drawn here."""
VISITING = 3
"""First purpose of trials that show where loops go; there is one for each policy followed."""
ROUNDS, FOLLOWED = 2, 3
"""Times that trees are fitted, and trees whose loops are followed between."""
VISITED, VOLUME = 100_000, 0.1
"""States that the loops of a policy visit, and how many of the volume there are for each."""
THROWN, TOLERANCE, LEAST_SHARE = 20_000, 0.02, 0.005
"""Needles that find the surface; how far [widths of the domain] a plane explains it, and the share
of it that stays a leaf, of a tree that begins with the surface."""
SPARE = 1.4
"""Times the nodes allowed, or of the first tree that is near the policy, that trees grow to."""
MOST = 250
"""Nodes that they grow to at most where neither is known."""
BYTES_A_NODE = 2
"""Fewer bytes than a node takes."""
HOPELESS, TRIES = 3.0, 3
"""Trees in a row that score worse than this, which end the pruning."""


def fit_candidates(choice: LoopChoice, rows: np.ndarray) -> None:
    """Fit trees of many sizes with some rows (R, N + 1) as leaves; they become candidates.

    Samples are states that loops of the policy visit, and some of the whole volume, so that what
    loops do not reach is not arbitrary. Once trees are fitted, states that loops of the best ones
    visit are added, labelled by the controller, and trees are fitted again (DAgger [1]_). Others
    begin with the surface where symbols change, and some know the whole volume alike. Where none is
    near the policy within the budget, the policy itself gives the labels: its cells may do better
    in closed loop than the controller, for they have a hysteresis.

    References
    ----------
    .. [1] S. Ross, G. Gordon and D. Bagnell, A reduction of imitation learning and structured
       prediction to no-regret online learning, AISTATS 2011.
    """
    judge, loops = choice.judge, choice.loops
    visits = [loops.visits(judge.policy, VISITING, VISITED)]
    visits.append(_volume(choice, int(VOLUME * len(visits[0].states)) + 1))
    for turn in range(ROUNDS):
        choice.say(f"trees where loops go, round {turn + 1} of {ROUNDS}")
        samples = _samples(judge, rows, visits, turn)
        _family(choice, rows, samples, Node(best_label(samples.right)))
        if turn + 1 < ROUNDS:
            for k, one in enumerate(_to_follow(choice)):
                purpose = VISITING + 1 + turn * FOLLOWED + k
                visits.append(loops.visits(one.tree, purpose, VISITED // FOLLOWED))
    choice.say("trees along the surface where symbols change")
    _family(choice, rows, samples, _along_surface(judge, rows))
    choice.say("trees of the whole volume")
    samples = _samples(judge, rows, [_volume(choice, VISITED)], ROUNDS + 1)
    _family(choice, rows, samples, _along_surface(judge, rows))
    if judge.name != "policy" and not choice.near(choice.best()[0]):
        choice.say("trees that do what the policy does")
        own = Judge.of(judge.policy, judge.states, judge.seed, judge.backend, judge.policy)
        rows, _ = own.rows()
        samples = _samples(own, rows, visits, ROUNDS)
        _family(choice, rows, samples, Node(best_label(samples.right)))


def _volume(choice: LoopChoice, count: int) -> Visits:
    """Return random states of the volume, with random labels in force."""
    judge = choice.judge
    rng = stream(judge.seed, FITTING)
    states = judge.policy.space.sample(count, rng)
    return Visits(states, rng.integers(len(judge.policy.alphabet) + 1, size=count))


def _samples(judge: Judge, rows: np.ndarray, visits: list[Visits], turn: int) -> Samples:
    """Return the states of visits, in no order, as samples of the unit cube.

    They are at the centres of their lattice steps: a plane does there what its rounded one will do.
    """
    space = judge.policy.space
    states = np.concatenate([some.states for some in visits])
    in_force = np.concatenate([some.in_force for some in visits])
    order = stream(judge.seed, FITTING, 1, turn).permutation(len(states))
    counts = fine_lattice(space)
    cube = (space.locate(states[order], counts) + 0.5) / counts
    right = judge.right(space.lower + cube * space.widths, in_force[order])
    every = np.arange(len(order))[:, None]
    return Samples(cube, right[every, rows.T[in_force[order]]])


def _along_surface(judge: Judge, rows: np.ndarray) -> Node:
    """Return a tree whose planes explain the surface where labels change, wherever loops go.

    Laws like XOR, which no single plane does anything for, begin with such a tree.
    """
    space, masks = judge.policy.space, judge.masks(rows)

    def of_cube(cube: np.ndarray) -> np.ndarray:
        return masks(space.lower + cube * space.widths).astype(np.uint64)

    seed = derived_seed(judge.seed, FITTING, 2)
    drawn = draw_samples(of_cube, space.n, len(rows), THROWN, [seed])
    surface = find_surface(of_cube, drawn, [seed, 1])
    return grow(surface, drawn, TOLERANCE, LEAST_SHARE, stream(seed, 2))


def _family(choice: LoopChoice, rows: np.ndarray, samples: Samples, root: Node) -> None:
    """Look at trees as one grows, and as it is pruned."""
    policy, budget = choice.judge.policy, choice.budget
    counts, claim = fine_lattice(policy.space), Guarantee("linear", content_hash(policy))

    def look(root: Node) -> Candidate:
        return choice.look(tree_of_rows(policy, to_lattice(root, counts), rows, claim))

    most, known = MOST, budget.limit
    if known is not None:
        most = int(SPARE * known) + 2 if budget.counts_nodes else min(MOST, known // BYTES_A_NODE)
    for grown in growing(root, samples, most):
        one = look(grown)
        if known is None and choice.near(one):
            known = grown.node_count
            most = min(most, int(SPARE * known))
        if grown.node_count >= most:
            break
    worse = 0
    for pruned in pruning(root, samples):
        worse = worse + 1 if look(pruned).score > HOPELESS else 0
        if worse == TRIES:
            return


def _to_follow(choice: LoopChoice) -> list[Candidate]:
    """Return the best trees of about the wanted size, whose loops are worth following."""
    most = SPARE * choice.best()[0].tree.node_count
    some = [one for one in choice.candidates if one.tree.node_count <= most]
    return sorted(some, key=lambda one: (one.score, one.tree.node_count))[:FOLLOWED]
