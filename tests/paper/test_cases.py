"""The paper's cases."""

from capsyn.paper.cases import CASES, count_solves, problem_of


def test_cases_are_read_as_the_paper_prints_them():
    for case in CASES:
        problem = problem_of(case)
        assert problem.settings.gamma == -5 and problem.settings.rule == "schedule"
        assert problem.partitions == (9, 9) and problem.max_level == case.max_level


def test_counts_do_not_depend_on_threads_or_backend():
    keys = ("solves", "cells", "vertices", "centers", "quarter")
    one, two, slow = (
        [[row[k] for k in keys] for row in count_solves(threads=t, backend=b)]
        for t, b in ((1, "auto"), (2, "auto"), (2, "numpy"))
    )
    assert one == two == slow
