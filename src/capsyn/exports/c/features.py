"""Decisions in C of a tree with features: their ranks first, in double precision, then the tree."""

from __future__ import annotations

from dataclasses import replace

from capsyn.cells.feature_tree import FeatureTree
from capsyn.exports.c.language import Part, comment, z_type
from capsyn.exports.c.styles.nested import nearest, nested
from capsyn.exports.c.styles.table import table
from capsyn.exports.feature_texts import c_ranks
from capsyn.modelling.domain import Box


def feature_decision(
    tree: FeatureTree, style: str, domain: Box, prefix: str, opening: str, of_rows: bool = False
) -> Part:
    """Return the function ``opening(z)`` that gives the label of lattice steps, in a style.

    Labels may be numbers `of_rows`.
    """
    ranked, integer = tree.ranked, z_type(tree.ranked.counts)
    argument = f"const {integer} z[{ranked.n}]"
    inner = f"static int16_t {prefix}_ranked({argument})"
    if style == "table":
        part = table(ranked, prefix, inner, of_rows)
    else:
        part = nested(ranked, domain, prefix, inner, argument, "lattice")
    lines = [f"{integer} ranked[{ranked.n}];"]
    body = [f"ranked[{i}] = ({integer})z[{i}];" for i in range(tree.n)]
    ranks = c_ranks(tree.features, "ranked[{}]")
    declared = [line for line in ranks if line.startswith("const ")]
    body += [line for line in ranks if not line.startswith("const ")]
    text = "".join(f"    {line}\n" for line in [*lines, *declared, *body])
    names = ", ".join(tree.features.names)
    about = f"Return the symbol of steps in the lattice. Features at their centres: {names}."
    within = f"""
{comment([about])}
static int16_t {prefix}_within(const {z_type(tree.counts)} z[{tree.n}])
{{
{text}    return {prefix}_ranked(ranked);
}}
"""
    return replace(part, text=part.text + within + nearest(tree, prefix, opening))
