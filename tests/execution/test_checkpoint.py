"""Checkpoints: runs that were killed, other runs, damaged blocks, two processes."""

import dataclasses
import json
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of
from safetensors.numpy import load_file, save_file
from typer.testing import CliRunner

import capsyn
from capsyn import Policy, problems
from capsyn.cli.app import app
from capsyn.controllers.ssac import BatchController
from capsyn.errors import CapsynWarning, ProblemError, SynthesisError
from capsyn.execution import checkpoint
from capsyn.execution.answers import Packed, digest
from capsyn.execution.checkpoint import Checkpoint
from capsyn.subdivision import limits as limits_of_runs

HERE = Path(__file__).parents[1] / "support" / "processes"
PROBLEM = problems.plain("cart-pendulum")


def file_of(policy, directory):
    path = directory / "policy.cap"
    policy.save(path)
    return path.read_bytes()


@pytest.fixture
def labelled(monkeypatch):
    """States that the controller was asked for."""
    asked = []
    masks = BatchController.masks
    monkeypatch.setattr(
        BatchController,
        "masks",
        lambda self, states: (asked.append(states), masks(self, states))[1],
    )
    return asked


def test_a_run_that_is_killed_again_and_again_ends_with_the_same_bytes(tmp_path):
    command = [sys.executable, str(HERE / "killed_runs.py"), str(tmp_path), "10", "3"]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    told = json.loads(run.stdout)
    assert told["finished"] < 5
    assert len(set(told["blocks"])) > 3  # most kills left something to go on from
    assert (tmp_path / "whole.cap").read_bytes() == (tmp_path / "killed.cap").read_bytes()


@pytest.mark.parametrize("backend", ["c", "numpy"])
def test_a_second_run_solves_nothing(tmp_path, labelled, backend):
    kept = tmp_path / "kept"
    options = {"max_level": 3, "backend": backend}
    plain = file_of(capsyn.synthesize(PROBLEM, **options), tmp_path)
    first = file_of(capsyn.synthesize(PROBLEM, checkpoint=kept, threads=2, **options), tmp_path)
    assert labelled
    labelled.clear()
    second = file_of(capsyn.synthesize(PROBLEM, checkpoint=kept, threads=1, **options), tmp_path)
    assert not labelled
    assert plain == first == second


@pytest.mark.parametrize(
    "options",
    [{"leaves": "affine"}, {"refine": "adaptive"}, {"leaves": "affine", "refine": "adaptive"}],
)
def test_subdivision_in_rounds_goes_on(tmp_path, options):
    options = {"max_level": 3, **options}
    plain = file_of(capsyn.synthesize(PROBLEM, **options), tmp_path)
    few = capsyn.synthesize(PROBLEM, max_solves=1000, checkpoint=tmp_path / "kept", **options)
    assert few.statistics["solves"] <= 1000
    whole = capsyn.synthesize(PROBLEM, checkpoint=tmp_path / "kept", **options)
    again = capsyn.synthesize(PROBLEM, checkpoint=tmp_path / "kept", **options)
    assert plain == file_of(whole, tmp_path) == file_of(again, tmp_path)


def test_an_error_keeps_what_was_solved(tmp_path, labelled):
    def stop(progress):
        if progress.level == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        capsyn.synthesize(PROBLEM, checkpoint=tmp_path / "kept", progress=stop, threads=1)
    solved = sum(map(len, labelled))
    labelled.clear()
    policy = capsyn.synthesize(PROBLEM, checkpoint=tmp_path / "kept")
    assert 0 < solved == policy.statistics["solves"] - sum(map(len, labelled))


def test_max_solves_may_be_raised(tmp_path, labelled):
    few = capsyn.synthesize(PROBLEM, max_solves=1000, checkpoint=tmp_path / "kept")
    assert few.statistics["stopped_by_max_solves"]
    labelled.clear()
    all_of_it = capsyn.synthesize(PROBLEM, checkpoint=tmp_path / "kept")
    assert sum(map(len, labelled)) == all_of_it.statistics["solves"] - few.statistics["solves"]
    assert file_of(all_of_it, tmp_path) == file_of(capsyn.synthesize(PROBLEM), tmp_path)


LIMITS = [
    {},
    {"max_memory": "3MB"},
    {"memory_limit": "60MB"},
    {"max_seconds": 1e4},
    {"free": 2**27},
]


@pytest.fixture
def small_blocks(monkeypatch):
    """Blocks of few cells, and what makes a policy under limits and some free memory."""
    monkeypatch.setattr(limits_of_runs, "ROOM", 100)
    monkeypatch.setattr(limits_of_runs, "TIMED_BYTES", 45_000)

    def run(free=2**29, **limits):
        monkeypatch.setattr(limits_of_runs, "available_memory", lambda: free)
        return capsyn.synthesize(PROBLEM, max_level=6, threads=1, **limits)

    return run


@pytest.mark.parametrize("second", range(len(LIMITS)))
@pytest.mark.parametrize("first", range(len(LIMITS)))
def test_other_limits_lose_nothing(tmp_path, labelled, small_blocks, first, second):
    kept = tmp_path / "kept"
    one = small_blocks(**LIMITS[first], checkpoint=kept)
    chunks = list(map(len, labelled))
    labelled.clear()
    two = small_blocks(**LIMITS[second], checkpoint=kept)
    assert not labelled
    assert file_of(one, tmp_path) == file_of(two, tmp_path)
    if first != second:  # blocks would have been others
        small_blocks(**LIMITS[second])
        assert chunks != list(map(len, labelled))
        assert sum(chunks) == sum(map(len, labelled))


def test_blocks_for_which_there_is_no_memory_are_cut_anew(tmp_path, labelled, small_blocks):
    kept = tmp_path / "kept"
    small_blocks(checkpoint=kept)
    solved = sum(map(len, labelled))
    little = {"max_memory": "400kB"}
    labelled.clear()
    again = small_blocks(**little, checkpoint=kept)
    assert 0 < sum(map(len, labelled)) < solved
    assert file_of(again, tmp_path) == file_of(small_blocks(**little), tmp_path)


def test_settled_values_are_those_of_what_is_kept(tmp_path):
    with Checkpoint(tmp_path, {}) as kept:
        assert kept.settle("room", 5) == 5 == kept.settle("room", 6)
    with Checkpoint(tmp_path, {}) as kept:  # nothing was kept
        assert kept.settle("room", 7) == 7
        kept.remember(lambda states: states[:, 0])(np.ones((3, 2)))
    with Checkpoint(tmp_path, {}) as kept:
        assert kept.settle("room", 8) == 7
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    for wrong in ([], {"room": 0}, {"room": "8"}, {"room": True}, {"room": 1.5}):
        (tmp_path / "manifest.json").write_text(json.dumps(manifest | {"settled": wrong}))
        with pytest.raises(ProblemError, match="no manifest of a checkpoint, or damaged"):
            Checkpoint(tmp_path, {})


@pytest.mark.parametrize(
    "other, named",
    [
        ({"seed": 1}, "`seed` is 0 there, 1 here"),
        ({"leaves": "affine"}, "`leaves` is 'constant' there, 'affine' here"),
        ({"refine": "adaptive"}, "`refine` is 'isotropic' there, 'adaptive' here"),
        ({"max_level": 3}, "run: `max_level` is 2 there, 3 here"),
        ({"partitions": [8, 9]}, "run: `partitions` is [9, 9] there, [8, 9] here"),
        (
            {"test_points": "vertices"},
            "run: `test_points` is 'vertices+center' there, 'vertices' here",
        ),
        ({"backend": "numpy"}, "run: `backend` is 'c' there, 'numpy' here"),
        (
            {"settings": dataclasses.replace(PROBLEM.settings, gamma=-3.0)},
            f"run: `gamma` is {PROBLEM.settings.gamma} there, -3.0 here",
        ),
        ({"problem": PROBLEM.replace(horizon=0.5)}, "run: `horizon` is 1.2 there, 0.5 here"),
        (
            {"problem": problems.plain("cart-pendulum-4")},
            "run: `name` is 'cart-pendulum' there, 'cart-pendulum-4' here",
        ),
        (
            {"problem": PROBLEM.replace(running_cost=lambda x: x[0] ** 2)},
            "run: `model` is",
        ),
    ],
)
def test_another_run_is_refused(tmp_path, other, named):
    settings = {"problem": PROBLEM, "max_level": 2, "backend": "c", "checkpoint": tmp_path / "kept"}
    capsyn.synthesize(**settings)
    before = {path: path.read_bytes() for path in (tmp_path / "kept").iterdir()}
    with pytest.raises(ProblemError, match="of another run") as error:
        capsyn.synthesize(**(settings | other))
    assert named in str(error.value) and "\n" not in str(error.value)
    assert before == {path: path.read_bytes() for path in (tmp_path / "kept").iterdir()}


def test_a_machine_with_other_bits_is_refused(tmp_path, monkeypatch):
    capsyn.synthesize(PROBLEM, max_level=1, checkpoint=tmp_path)
    solve = BatchController.solve

    def other(self, states):
        solution = solve(self, states)
        cost = solution.cost.copy()
        cost[-1] = np.nextafter(cost[-1], np.inf)
        return dataclasses.replace(solution, cost=cost)

    monkeypatch.setattr(BatchController, "solve", other)
    with pytest.raises(ProblemError, match="run: `bits of results` is"):
        capsyn.synthesize(PROBLEM, max_level=1, checkpoint=tmp_path)


def truncate(path):
    path.write_bytes(path.read_bytes()[:-7])


def flip(path):
    data = bytearray(path.read_bytes())
    data[-3] ^= 4
    path.write_bytes(data)


def empty(path):
    path.write_bytes(b"")


def huge(path):
    path.write_bytes((2**60).to_bytes(8, "little") + path.read_bytes()[8:])


def forged(change):
    """Return what writes a block whose checksum is right but whose arrays are not."""

    def forge(path):
        arrays = load_file(path)
        about = json.dumps([False, ["uint64"]])
        about = change(arrays) or about
        save_file(arrays, path, {"about": about, "sha256": digest(arrays, about)})

    return forge


DAMAGE = [
    truncate,
    flip,
    empty,
    huge,
    forged(lambda a: a.update(answer0=a["answer0"][:-1])),
    forged(lambda a: a.update(answer0=a["answer0"].astype(float))),
    forged(lambda a: a.update(keys=a["keys"][:, :8].copy())),
    forged(lambda a: a.update(rows=a["rows"] - 2**62)),
    forged(lambda a: a.pop("rows") is None),
    forged(lambda a: json.dumps([False, ["object"]])),
    forged(lambda a: json.dumps([False, 3])),
    forged(lambda a: json.dumps([False, {"uint64": 1}])),
    forged(lambda a: json.dumps([False, [["uint64"]]])),
    forged(lambda a: json.dumps([0, ["uint64"]])),
    forged(lambda a: json.dumps(["no", ["uint64"]])),
    forged(lambda a: a.update(answer1=a["answer0"]) or json.dumps([False, ["uint64", "uint64"]])),
    forged(lambda a: a.update(answer0=a["answer0"].astype(np.uint64)) or '[false, ["uint8"]]'),
    forged(lambda a: a.update(answer0=a["answer0"].astype(np.float32)) or '[false, ["float64"]]'),
    forged(lambda a: a.update(answer0=np.array(3, np.uint8))),
    forged(lambda a: "[" * 100_000),
]


@pytest.mark.parametrize("damage", DAMAGE, ids=range(len(DAMAGE)))
def test_a_damaged_block_is_solved_again(tmp_path, damage):
    whole = file_of(capsyn.synthesize(PROBLEM, max_level=2, checkpoint=tmp_path / "a"), tmp_path)
    (block,) = (tmp_path / "a").glob("block-*")
    damage(block)
    with pytest.warns(CapsynWarning, match="damaged and removed, its states are solved again"):
        again = capsyn.synthesize(PROBLEM, max_level=2, checkpoint=tmp_path / "a")
    assert file_of(again, tmp_path) == whole
    assert not block.exists()
    assert (
        file_of(  # and no warning
            capsyn.synthesize(PROBLEM, max_level=2, checkpoint=tmp_path / "a"), tmp_path
        )
        == whole
    )


def test_one_process_at_a_time(tmp_path):
    script = (
        "import sys; from capsyn.execution.checkpoint import Checkpoint; "
        "kept = Checkpoint(sys.argv[1], {}); print('open', flush=True); sys.stdin.read()"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    try:
        assert other.stdout.readline() == b"open\n"
        with pytest.raises(ProblemError, match="is in use by another process"):
            Checkpoint(tmp_path, {})
    finally:
        other.kill()
        other.communicate()
    Checkpoint(tmp_path, {}).close()


def test_a_directory_of_something_else_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("hello")
    with pytest.raises(ProblemError, match="must be an empty directory or a checkpoint.*thesis"):
        Checkpoint(tmp_path, {})
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    with pytest.raises(ProblemError, match="must be a directory to write to"):
        Checkpoint(tmp_path / "thesis.tex", {})
    (tmp_path / "manifest.json").write_text("[" * 100_000)
    with pytest.raises(ProblemError, match="no manifest of a checkpoint, or damaged"):
        Checkpoint(tmp_path, {})


def test_a_full_disk_stops_the_checkpoint_not_the_run(tmp_path, monkeypatch):
    def full(path, write):
        if "block" in str(path):
            raise OSError(28, "No space left on device")
        atomic_write(path, write)

    atomic_write = checkpoint.atomic_write
    monkeypatch.setattr(checkpoint, "atomic_write", full)
    monkeypatch.setattr(checkpoint, "INTERVAL", 0.0)
    with pytest.warns(CapsynWarning, match="goes no further: .*No space left") as warned:
        policy = capsyn.synthesize(PROBLEM, max_level=2, checkpoint=tmp_path / "a")
    assert len(warned) == 1
    plain = capsyn.synthesize(PROBLEM, max_level=2)
    assert file_of(policy, tmp_path) == file_of(plain, tmp_path)


def test_blocks_are_few_in_a_long_run(tmp_path, monkeypatch):
    now, written = [0.0], []
    monkeypatch.setattr(checkpoint, "_write_block", lambda path, new: written.append(len(new)))
    monkeypatch.setattr(checkpoint.time, "monotonic", lambda: now[0])
    with Checkpoint(tmp_path, {}) as kept:
        label = kept.remember(lambda states: states[:, 0])
        for second in range(20_000):
            now[0] = float(second)
            label(np.array([[second, 0.0]]))
    assert sum(written) == 20_000 and max(written) <= 200  # 1 % of the time at most is lost
    assert len(written) < 700


def test_answers_that_are_not_finite_stop_a_run_that_goes_on_all_the_same(tmp_path):
    lost = PROBLEM.replace(running_cost=lambda x: 1 / (x[0] - x[0]))
    for _ in range(2):
        with pytest.raises(SynthesisError, match="gave no finite result"):
            capsyn.synthesize(lost, checkpoint=tmp_path, settings=_steps(lost.settings))


def _steps(settings):
    return dataclasses.replace(settings, steps=8)


masks = arrays_of.arrays(np.uint64, st.integers(1, 5))


@given(st.lists(masks, min_size=1, max_size=5), st.integers(0, 3))
def test_packed_answers_come_back_as_they_were(found, variants):
    rng = np.random.default_rng(len(found))
    pairs = [(m, rng.standard_normal((len(m), variants, 2))) for m in found]
    for answers in (found, pairs):
        packed = Packed.of(answers)
        packed.check()
        for answer, back in zip(answers, packed.answers(), strict=True):
            together = isinstance(answer, tuple)
            assert isinstance(back, tuple) == together
            for a, b in zip(answer if together else [answer], back if together else [back]):
                assert a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def test_masks_and_scores_are_kept_together(tmp_path):
    def label(states):
        return np.full(len(states), 3, np.uint64), states[:, None, :] * np.pi

    chunks = [np.random.default_rng(k).random((100 + k, 2)) for k in range(7)]
    with Checkpoint(tmp_path, {"answers": "scored"}) as kept:
        first = [kept.remember(label)(chunk) for chunk in chunks]
    with Checkpoint(tmp_path, {"answers": "scored"}) as kept:
        again = [kept.remember(None)(chunk) for chunk in chunks[::-1]][::-1]
        assert kept.taken == sum(map(len, chunks))
    for (m, s), (m2, s2) in zip(first, again, strict=True):
        assert m.dtype == m2.dtype and (m == m2).all() and s.tobytes() == s2.tobytes()


def test_the_command_keeps_and_goes_on(tmp_path):
    arguments = ["synth", "cart-pendulum", "--max-level", "2", "--checkpoint", str(tmp_path / "a")]
    for name in ("1.cap", "2.cap"):
        result = CliRunner().invoke(app, [*arguments, "-o", str(tmp_path / name)])
        assert result.exit_code == 0, result.output
    assert (tmp_path / "1.cap").read_bytes() == (tmp_path / "2.cap").read_bytes()
    assert list((tmp_path / "a").glob("block-*"))


def test_a_run_that_goes_on_tells_what_it_took(tmp_path, monkeypatch, capsys):
    from capsyn.cli import app as cli

    def synth():
        line = "capsyn synth cart-pendulum --max-level 1 -o p.cap --checkpoint kept"
        monkeypatch.setattr(sys, "argv", line.split())
        with pytest.raises(SystemExit):
            cli.main()
        return capsys.readouterr()

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    assert synth().err == ""
    solves = Policy.load("p.cap").statistics["solves"]
    assert synth().err == f"{solves:,} solves came from 'kept'\n"
