"""A real scheduler and worker processes on loopback: the same bytes as without them."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest
from dask_processes import processes, start_scheduler, start_worker

import capsyn
from capsyn import cluster, problems
from capsyn.alphabet import Alphabet
from capsyn.errors import CapsynWarning, KernelBuildError, ProblemError, SynthesisError

distributed = pytest.importorskip("distributed", reason="needs the extra 'distributed'")

PROBLEM = problems.get("cart-pendulum-4")
NO_COMPILER = {"CC": "no-such-compiler"}


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """The scheduler of two workers."""
    with processes() as start:
        address, _ = start_scheduler(start, tmp_path_factory.mktemp("scheduler"))
        for name in ("one", "two"):
            start_worker(start, address, name)
        with distributed.Client(address) as client:
            client.wait_for_workers(2, timeout=60)
        yield address


@pytest.fixture
def client(address):
    with distributed.Client(address) as client:
        yield client


@pytest.fixture
def other(tmp_path):
    """A scheduler of its own, and what starts workers for it and returns a client."""
    with processes() as start:
        address, scheduler = start_scheduler(start, tmp_path)
        with distributed.Client(address) as client:

            def workers(*environments):
                started = [
                    start_worker(start, address, f"w{k}", **environment)
                    for k, environment in enumerate(environments)
                ]
                client.wait_for_workers(len(started), timeout=60)
                return client, started, scheduler

            yield workers


def file_of(policy, directory):
    path = directory / "policy.cap"
    policy.save(path)
    return path.read_bytes()


@pytest.mark.parametrize("backend", ["c", "numpy"])
@pytest.mark.parametrize("name, level", [("cart-pendulum-4", 5), ("double-tank-a", 3)])
def test_the_same_bytes_as_without_a_cluster(client, tmp_path, name, level, backend):
    seen = []
    options = {"max_level": level, "backend": backend}
    local = capsyn.synthesize(problems.get(name), **options)
    remote = capsyn.synthesize(problems.get(name), executor=client, progress=seen.append, **options)
    assert file_of(remote, tmp_path) == file_of(local, tmp_path)
    assert seen[-1].total == remote.statistics["solves"]


def test_workers_do_the_work(client, monkeypatch):
    def never(self, states):
        raise AssertionError("solved in this process")

    monkeypatch.setattr("capsyn.ssac.BatchController.masks", never)
    with pytest.raises(AssertionError):
        capsyn.synthesize(PROBLEM, max_level=1)
    monkeypatch.setattr("capsyn.synthesis.sample_statistics", lambda *_: {})
    capsyn.synthesize(PROBLEM, max_level=1, executor=client)


def test_a_worker_is_killed_half_way(other, tmp_path):
    client, workers, _ = other({}, {})
    options = {"max_level": 6, "backend": "numpy"}
    whole = capsyn.synthesize(PROBLEM, **options)
    half = whole.statistics["solves"] / 2

    def kill(progress):
        if progress.total > half:
            workers[0].kill()

    policy = capsyn.synthesize(PROBLEM, executor=client, progress=kill, **options)
    assert file_of(policy, tmp_path) == file_of(whole, tmp_path)
    assert workers[0].wait() and len(client.nthreads()) == 1


def test_all_workers_are_killed_and_others_come(other, tmp_path):
    client, workers, _ = other({})
    options = {"max_level": 5, "backend": "numpy"}
    whole = capsyn.synthesize(PROBLEM, **options)
    new = []

    def replace(progress):
        if progress.total > whole.statistics["solves"] / 2 and not new:
            new.append(True)
            workers[0].kill()
            other({})

    policy = capsyn.synthesize(PROBLEM, executor=client, progress=replace, **options)
    assert file_of(policy, tmp_path) == file_of(whole, tmp_path)


def test_the_scheduler_is_killed_half_way(other, tmp_path):
    client, _, scheduler = other({})

    def kill(progress):
        if progress.level == 2:
            scheduler.kill()

    options = {"max_level": 5, "backend": "numpy", "checkpoint": tmp_path / "kept"}
    started = time.monotonic()
    with pytest.raises(SynthesisError, match="the Dask scheduler was lost"):
        capsyn.synthesize(PROBLEM, executor=client, progress=kill, **options)
    assert time.monotonic() - started < 30
    whole = capsyn.synthesize(PROBLEM, **options)  # goes on without
    del options["checkpoint"]
    assert file_of(whole, tmp_path) == file_of(capsyn.synthesize(PROBLEM, **options), tmp_path)


def test_a_checkpoint_of_a_cluster_goes_on_in_one_process(client, tmp_path):
    options = {"max_level": 4, "checkpoint": tmp_path / "kept"}
    remote = capsyn.synthesize(PROBLEM, executor=client, **options)
    told = []
    local = capsyn.synthesize(PROBLEM, progress=told.append, **options)
    assert file_of(remote, tmp_path) == file_of(local, tmp_path)
    assert len(list((tmp_path / "kept").glob("block-*"))) == 1


def test_workers_without_a_compiler(other, tmp_path):
    client, *_ = other(NO_COMPILER)
    with pytest.warns(CapsynWarning, match="all workers solve with NumPy") as warned:
        policy = capsyn.synthesize(PROBLEM, max_level=2, executor=client)
    assert len(warned) == 1
    local = capsyn.synthesize(PROBLEM, max_level=2, backend="numpy")
    assert file_of(policy, tmp_path) == file_of(local, tmp_path)
    with pytest.raises(ProblemError, match=r"worker tcp://127.0.0.1:\d+ cannot take part: no C"):
        capsyn.synthesize(PROBLEM, max_level=2, backend="c", executor=client)
    other(NO_COMPILER, {})
    with pytest.raises(ProblemError, match='no-such-compiler.*backend "numpy" all can take part'):
        capsyn.synthesize(PROBLEM, max_level=2, executor=client)
    policy = capsyn.synthesize(PROBLEM, max_level=2, executor=client, backend="numpy")
    assert file_of(policy, tmp_path) == file_of(local, tmp_path)


def test_a_worker_with_other_bits_is_refused(other):
    client, *_ = other(
        {"CC": "cc -mno-fma" if os.uname().machine == "x86_64" else "cc -ffp-contract=off"}
    )
    with pytest.raises(ProblemError, match="its results have other bits: its compiler is .*-m"):
        capsyn.synthesize(PROBLEM, max_level=2, executor=client)
    with pytest.raises(SynthesisError):  # agreed in the simulation, whose arithmetic is exact
        raise SynthesisError
