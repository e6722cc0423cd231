"""Make the boat's controller small: three kinds of decision trees, and the policy's automaton."""

from boat import problem

import capsyn

policy = capsyn.synthesize(problem)
print(f"{policy.cells.leaf_count} cells")

for mode in ("exact", "freedom", "linear"):
    tree = capsyn.compress(policy, mode)
    print(f"{mode}: {tree.node_count} nodes, at most {tree.depth} comparisons")
    print(f"    {tree.guarantee.text}")

run = capsyn.simulate(tree, [8.0, 0.0], duration=40.0, rate=20.0)  # a tree is a policy
print(f"after 40 s the boat is at {run.states[-1, 0]:.2f} m")

machine = capsyn.Automaton.of(policy)
names = dict(zip(machine.vertices, machine.names))
for edge in machine.edges:
    if edge.source != edge.target and edge.possible is not False:
        chatter = ", chattering somewhere" if edge.sliding else ""
        print(f"{names[edge.source]} -> {names[edge.target]}: {edge.rate:.2g} per second{chatter}")
