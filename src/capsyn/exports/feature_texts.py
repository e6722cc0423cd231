"""The ranks of a tree's features as source text, for targets that walk through its tree."""

from __future__ import annotations

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.feature_tree import Features, FeatureTree
from capsyn.cells.split_tree import SplitTree
from capsyn.programs.texts import (
    JAVASCRIPT,
    PYTHON_HELPERS,
    c_lines,
    javascript_lines,
    python_lines,
)


def features_of(tree: CellTree | SplitTree) -> Features | None:
    """Return the features of a tree, if it has any."""
    return tree.features if isinstance(tree, FeatureTree) else None


def feature_note(features: Features) -> str:
    """Return what a user must know about the features of a tree."""
    operations = sum(name != "const" for name, *_ in features.program.instructions)
    text = (
        f"Features: {', '.join(features.names)}, at the centre of a lattice step, by {operations} "
        "operations in double precision"
    )
    if features.margin is None:
        return f"{text}; the lattice is too fine to say how near they come to thresholds."
    return (
        f"{text}. On the lattice none comes nearer to a threshold than {features.margin:.1e} of "
        "its span, far more than rounding moves it."
    )


def python_ranks(features: Features) -> str:
    """Return the function ``with_ranks(steps)``, with what it calls."""
    lines, results = python_lines(features.program, _names(features))
    text = "\n".join(lines)
    helpers = "".join(f"\n{code}" for name, code in PYTHON_HELPERS.items() if f"{name}(" in text)
    thresholds = ",\n    ".join(
        "(" + "".join(f"{t!r}, " for t in row.tolist()).rstrip() + ")"
        for row in features.thresholds
    )
    body = "".join(f"    {line}\n" for line in lines)
    return f'''

# Names of the features, and the values from where on they have their ranks.
FEATURES = {tuple(features.names)!r}
RANKS = (
    {thresholds},
)
{helpers}

def with_ranks(steps):
    """Return lattice steps with the ranks of the features, at the centre of the step."""
    {", ".join(_names(features))}, = map(float, steps)
{body}    values = {", ".join(results)},
    return steps + [sum(v >= t for t in row) for v, row in zip(values, RANKS)]
'''


def javascript_ranks(features: Features) -> str:
    """Return the function ``withRanks(steps)``, with what it calls."""
    lines, results = javascript_lines(features.program, _names(features))
    body = "".join(f"  {line}\n" for line in lines)
    helpers = "".join(
        f"const m_{name} = {code};\n" for name, code in JAVASCRIPT.items() if f"m_{name}(" in body
    )
    rows = ", ".join("[" + ", ".join(map(repr, t.tolist())) + "]" for t in features.thresholds)
    names = ", ".join(f'"{_escaped(name)}"' for name in features.names)
    return f"""
/** Names of the features, and the values from where on they have their ranks. */
export const FEATURES = [{names}];
const RANKS = [{rows}];
{helpers}
/** Return lattice steps with the ranks of the features, at the centre of the step. */
function withRanks(steps) {{
  const [{", ".join(_names(features))}] = steps;
{body}  const values = [{", ".join(results)}];
  return steps.concat(values.map((v, k) => RANKS[k].filter((t) => v >= t).length));
}}
"""


def c_ranks(features: Features, put: str) -> list[str]:
    """Return statements of C that put the rank of each feature, of steps ``z``, at its place.

    `put` is an assignable expression with ``{}`` for the number of the feature after the states.
    """
    used = features.program.used_inputs()
    lines = [f"const double {name} = (double)z[{i}];" for i, name in enumerate(_names(features))
             if i in used]  # fmt: skip
    values, results = c_lines(features.program, _names(features))
    lines += values
    for k, (value, thresholds) in enumerate(zip(results, features.thresholds)):
        place = put.format(features.program.input_count + k)
        lines.append(f"{place} = 0;")
        for rank, threshold in enumerate(thresholds.tolist(), start=1):
            lines += [f"if ({value} >= {threshold!r}) {{", f"    {place} = {rank};", "}"]
    return lines


def _names(features: Features) -> list[str]:
    return [f"v{i}" for i in range(features.program.input_count)]


def _escaped(name: str) -> str:
    return name.replace("\\", "\\\\").replace('"', '\\"')
