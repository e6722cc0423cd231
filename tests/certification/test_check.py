"""The checker of certificates: it takes what is proved, and refuses what is changed."""

import ast
import dataclasses
import io
import zipfile

import numpy as np
import pytest

import capsyn
from capsyn import Alphabet, Ball, Box, Problem, SsacSettings
from capsyn.certification import check as checking
from capsyn.certification.check import check
from capsyn.certification.checker.bounds import RULES, Interval, bounds
from capsyn.certification.checker.sets import Tree, clip, corners, within
from capsyn.errors import CertificateError
from capsyn.programs.builder import ProgramBuilder
from capsyn.programs.operations import OPERATIONS
from support.proofs.tampering import CHANGES, proof_arrays, proved_case, refusal, tampered

KINDS = {
    "cells, plain": 331,
    "a tree, memory, holds, noise": 42,
    "an oblique tree": 44,
    "holds, delay, noise": 79,
    "memory, delay, noise": 116,
    "gaps": 296,
    "one state": 36,
    "rates that jump, holds, delay": 45,
    "a pendulum, holds": 16,
    "a torus, holds, delay": 90,
    "roots, noise": 57,
    "an oscillator, delay, noise": 24,
    "three states, delay": 28,
    "told inputs, holds": 35,
}
"""Kinds of loops, by the numbers of random ones that are so."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("proofs")


@pytest.mark.parametrize("seed", KINDS.values(), ids=KINDS)
def test_a_proof_holds(seed, folder):
    case, proof = proved_case(seed)
    proof.save(folder / "p.proof")
    found = check(folder / "p.proof", case.policy)
    assert found.cells == np.isfinite(proof.arrival.bound).any(axis=0).sum()
    assert sum(len(wave.held) for wave in proof.arrival.waves) >= 4
    assert found.plant == "given" and 0 < found.seconds < 60


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
def test_a_changed_proof_is_refused(change, folder):
    refused = 0
    for seed in (116, 42):
        case, _ = proved_case(seed)
        arrays = proof_arrays(seed, folder / f"{seed}.proof")
        rng = np.random.default_rng(seed)
        for some in (tampered(arrays, change, rng) for _ in range(3)):
            if some is not None:
                reason = refusal(case, some)
                assert reason is not None and "\n" not in reason and len(reason) < 200
                refused += 1
    assert refused >= 2


def test_the_policy_is_the_plant_unless_another_is_given(folder):
    problem = Problem(
        "mover", lambda x, u: [u[0], u[1]], Box([-1, -1], [1, 1]),
        Alphabet([(a, b) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]), [0, 0], 0.2,
        running_cost=lambda x: x[0] ** 2 + x[1] ** 2, target=Ball([0, 0], 0.3), outside="nearest",
        settings=SsacSettings(rule="steepest", sample_time=0.02),
    )  # fmt: skip
    policy = capsyn.synthesize(problem)
    certificate = capsyn.certify(policy, counts=10)
    assert certificate.arrival == 1.0
    certificate.save(folder / "own.proof")
    found = check(folder / "own.proof", policy)
    assert found.plant == "its own" and found.cells == 100
    entries = policy.cells.entries.copy()
    leaf = np.flatnonzero(entries < 0)[7]
    entries[leaf] = -1 - (-entries[leaf]) % 4
    other = dataclasses.replace(policy.cells, entries=entries, mixed_cells=np.zeros(0, np.int32),
                                mixed_labels=policy.cells.mixed_labels[:0])  # fmt: skip
    with pytest.raises(CertificateError, match="another policy"):
        check(folder / "own.proof", dataclasses.replace(policy, cells=other))


@pytest.mark.parametrize("seed", [42, 331])
def test_holds_and_noise_that_are_others_are_refused(seed, folder):
    case, _ = proved_case(seed)
    arrays = proof_arrays(seed, folder / f"{seed}.proof")
    head = checking.json.loads(arrays["header"].tobytes())
    holds = [hold + 3 for hold in head["holds"]]
    for change in ({"holds": holds}, {"kinds": head["kinds"][::-1]}, {"nearest": None},
                   {"states": 1}, {"noise": [-1, 0]}, {"noise": ["x"]}, {"period": 0.0},
                   {"period": None}, {"delay": 2.0}, {"format": 2}, {"parameters": [[0]]},
                   {"rates": {}}, {"target": None}, {"space": None}):  # fmt: skip
        header = np.frombuffer(checking.json.dumps(head | change).encode(), dtype=np.uint8)
        with pytest.raises((CertificateError, *checking.MALFORMED)):
            claims = checking.claims_of(head | change, case.policy)
            checking.check_proof(claims, arrays | {"header": header})


def _written(arrays, path):
    with open(path, "wb") as file:
        np.savez(file, **arrays)
    return path


def test_files_that_are_none_are_refused_in_one_line(folder):
    case, proof = proved_case(79)
    proof.save(folder / "whole.proof")
    whole = (folder / "whole.proof").read_bytes()
    arrays = proof_arrays(79, folder / "79.proof")
    rng, files = np.random.default_rng(0), [b"", b"capsyn", whole[:-1], whole[: len(whole) // 2]]
    for _ in range(20):
        damaged = bytearray(whole)
        for at in rng.integers(0, len(whole), 8):
            damaged[at] ^= 1 << int(rng.integers(8))
        files.append(bytes(damaged))
    for name, change in (
        ("flows", arrays["flows"]["v"]), ("starts", np.array([None])), ("bound", np.zeros(3)),
        ("counts", np.array([1 << 40, 1 << 40])), ("counts", arrays["counts"] * 1.0),
        ("lower", arrays["lower"] - 1), ("header", np.zeros(3, np.uint8)),
        ("twins", arrays["twins"] + 9), ("pieces", arrays["pieces"][:-1]),
        ("pieces", arrays["pieces"][:0]), ("header", np.frombuffer(b"[" * 9999, np.uint8)),
    ):  # fmt: skip
        files.append(_written(arrays | {name: change}, folder / "c.proof").read_bytes())
    missing = {name: array for name, array in arrays.items() if name != "twins"}
    files.append(_written(missing, folder / "c.proof").read_bytes())
    for content in files:
        (folder / "c.proof").write_bytes(content)
        try:
            check(folder / "c.proof", case.policy)
        except CertificateError as error:
            assert "\n" not in str(error) and len(str(error)) < 300
        else:  # a bit that nothing depends on, such as the time of a file
            with zipfile.ZipFile(io.BytesIO(content)) as file:
                assert file.testzip() is None
    with pytest.raises(CertificateError, match="cannot be read"):
        check(folder / "nowhere.proof", case.policy)


def test_nothing_is_taken_from_what_makes_proofs():
    files = [checking.__file__]
    folder = checking.__file__.replace("check.py", "checker")
    files += [f"{folder}/{name}.py" for name in "bounds sets flows cells moving pieces".split()]
    for path in files:
        with open(path) as file:
            text = file.read()
        names = [node.module for node in ast.walk(ast.parse(text))
                 if isinstance(node, ast.ImportFrom)]  # fmt: skip
        assert not any(name.startswith("capsyn.reach") for name in names)
        assert not {"capsyn.programs.intervals", "capsyn.native.bounds"} & set(names)
        assert text.count("\n") < 300


def _one(name, arity, constant=None):
    builder = ProgramBuilder()
    x = [builder.input() for _ in range(2)]
    operands = [x[0], x[1] if constant is None else builder.constant(constant)][:arity]
    ports = (("x", 2),), (("y", 1),)
    return builder.build("one", *ports, [builder.apply(name, *operands)])


@pytest.mark.parametrize("name", RULES)
def test_bounds_hold_for_values_and_slopes(name):
    rng = np.random.default_rng(len(name))
    arity = OPERATIONS[name].arity
    for constant in (None, 2.0, 3.0, -1.0, 0.5) if name == "pow" else (None,):
        program = _one(name, arity, constant)
        low = rng.normal(size=(2, 400)) * 10.0 ** rng.uniform(-3, 1, 400)
        if name in ("asin", "pow", "log1p"):
            low = np.clip(np.abs(low), 0, 0.5)
        wide = 10.0 ** rng.uniform(-4, 0, (2, 400))
        wide *= rng.random((2, 400)) < 0.8
        high, unit = low + wide, np.eye(2)[:, :, None]
        x = [Interval(*ends) for ends in zip(low, high)]
        (value,), (slope,) = bounds(program, x, [Interval(e, e) for e in unit])
        known = np.isfinite(np.broadcast_to(value.low, 400) + value.high)
        assert known.mean() > 0.2
        previous = None
        for share in np.linspace(0, 1, 23):
            point = low + share * wide
            (at,) = program.evaluate(point)
            assert (at[0][known] >= np.broadcast_to(value.low, 400)[known]).all()
            assert (at[0][known] <= np.broadcast_to(value.high, 400)[known]).all()
            if previous is not None and slope is not None and name != "remainder":
                step = wide / 22
                ends = [np.broadcast_to(x, (2, 400)) for x in (slope.low, slope.high)]
                least = np.minimum(ends[0] * step, ends[1] * step).sum(axis=0)
                most = np.maximum(ends[0] * step, ends[1] * step).sum(axis=0)
                moved, slack = at[0] - previous, 1e-12 * (1 + np.abs(at[0]))
                sure = known & np.isfinite(least + most)
                assert (moved[sure] >= least[sure] - slack[sure]).all()
                assert (moved[sure] <= most[sure] + slack[sure]).all()
            previous = at[0]


def test_an_operation_that_is_not_known_is_named():
    with pytest.raises(CertificateError, match="does not know the operation 'fmod'"):
        bounds(_one("fmod", 2), [Interval(np.zeros(1), np.ones(1))] * 2)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_clipping_keeps_all_and_containment_is_true(n):
    rng = np.random.default_rng(n)
    points = (
        rng.normal(size=(300, 7, n)) if n == 2 else np.sort(rng.normal(size=(300, 2, n)), axis=1)
    )
    a, limit = rng.normal(size=(300, n)), 0.5 * rng.normal(size=300)
    with np.errstate(all="ignore"):
        kept, alive = clip(points, a, limit)
    for _ in range(300):
        if n == 2:  # any order, and points within
            inside = (rng.dirichlet(np.full(7, 0.4), 300)[:, :, None] * points).sum(axis=1)
        else:
            inside = points[:, 0] + rng.random((300, n)) * np.ptp(points, axis=1)
        good = (inside * a).sum(axis=1) <= limit
        assert alive[good].all()
        room = np.full((300, n), 1e-9)
        one = np.repeat(inside[:, None], kept.shape[1], axis=1)
        if n == 2:
            some = rng.normal(size=(300, 1, 2))  # no direction in which it is beyond all of them
            far = (kept * some).sum(axis=2).max(axis=1) - (inside[:, None] * some).sum(axis=2)[:, 0]
            assert (far[good] >= -1e-12).all()
            assert (
                (kept * a[:, None]).sum(axis=2).max(axis=1)[alive] <= limit[alive] + 1e-12
            ).all()
        else:
            assert within(one, 0 * room, kept, room)[good].all()


def test_a_set_is_within_another_only_where_it_is():
    square = corners(np.zeros((1, 2)), np.ones((1, 2)), 6)
    none, room = np.zeros((1, 2)), np.full((1, 2), 1e-6)
    for moved, inside in ((0.0, True), (0.9e-6, True), (1.1e-6, False), (-1.1e-6, False)):
        assert within(square + moved, none, square, room)[0] == inside
        assert within(square[:, ::-1] + moved, none, square, room)[0] == inside
    turned = square[:, [0, 2, 1, 3, 4, 5]]  # no polygon: only triangles of neighbours are looked at
    assert not within(square[:, ::-1] * 1.0, none, turned * 0.9, room)[0]
    for errors, inside in (((0.1, 0.2), True), ((0.2, 0.1), False), ((0.1, 0.1), False)):
        one, other = (np.full((1, 2), error) for error in errors)
        assert within(square, one, square, other)[0] == inside


@pytest.mark.parametrize("seed", [44, 16, 35, 90])
def test_leaves_are_those_of_lookups(seed):
    case, _ = proved_case(seed)
    policy = case.policy
    if not hasattr(policy, "guarantee"):
        policy = capsyn.compression.trees.exact_tree(policy)
    tree, space = Tree.of(policy.cells, policy.space), policy.space
    rng = np.random.default_rng(seed)
    states = space.sample(2000, seed) + space.periods * rng.integers(-2, 3, (2000, 1))
    leaves = policy.cells.find(space.locate(states, policy.cells.counts))
    radius = 0.05 * space.widths * rng.random((2000, 1))
    box, leaf, moved = tree.under(states - radius, states + radius)
    found = set(zip(box.tolist(), leaf.tolist()))
    assert set(enumerate(leaves.tolist())) <= found
    alive = tree.met(states[box] - radius[box], states[box] + radius[box], leaf, moved)
    kept = set(zip(box[alive].tolist(), leaf[alive].tolist()))
    assert set(enumerate(leaves.tolist())) <= kept
