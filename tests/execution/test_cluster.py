"""A real scheduler and worker processes on loopback: the same bytes as without them."""

import json
import os
import platform
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from typer.testing import CliRunner

import capsyn
from capsyn import problems
from capsyn.cli.app import app
from capsyn.errors import CapsynWarning, ProblemError, SynthesisError
from capsyn.execution import checkpoint, cluster
from support.processes.dask import processes, start_scheduler, start_worker

distributed = pytest.importorskip("distributed", reason="needs the extra 'distributed'")

PROBLEM = problems.plain("cart-pendulum-4")
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
        # what is submitted while a client tries to reconnect is lost when it gives up
        with distributed.Client(address, timeout=cluster.CONNECT_SECONDS) as client:

            def workers(*environments):
                started = [
                    start_worker(start, address, f"w{k}", **environment)
                    for k, environment in enumerate(environments)
                ]
                if started:
                    client.wait_for_workers(len(started), timeout=60)
                return client, started, scheduler

            yield workers


def file_of(policy, directory):
    path = directory / "policy.cap"
    policy.save(path)
    return path.read_bytes()


@pytest.mark.parametrize("backend", ["c", "numpy"])
@pytest.mark.parametrize(
    "name, level, leaves, refine",
    [
        ("cart-pendulum-4", 4, "constant", "isotropic"),
        ("double-tank-a", 3, "constant", "adaptive"),
        ("cart-pole", 1, "affine", "isotropic"),
        ("cart-pole", 1, "affine", "adaptive"),
    ],
)
def test_the_same_bytes_as_without_a_cluster(
    client, tmp_path, name, level, leaves, refine, backend
):
    seen = []
    options = {"max_level": level, "leaves": leaves, "refine": refine, "backend": backend}
    local = capsyn.synthesize(problems.plain(name), **options)
    remote = capsyn.synthesize(
        problems.plain(name), executor=client, progress=seen.append, **options
    )
    assert file_of(remote, tmp_path) == file_of(local, tmp_path)
    assert seen[-1].total == remote.statistics["solves"]


def test_workers_do_the_work(client, monkeypatch):
    def never(self, states):
        raise AssertionError("solved in this process")

    monkeypatch.setattr("capsyn.controllers.ssac.BatchController.masks", never)
    with pytest.raises(AssertionError):
        capsyn.synthesize(PROBLEM, max_level=1)
    monkeypatch.setattr("capsyn.synthesis.synthesize.sample_statistics", lambda *_: {})
    capsyn.synthesize(PROBLEM, max_level=1, executor=client)


def test_a_worker_is_killed_half_way(other, tmp_path):
    client, workers, _ = other({}, {})
    options = {"max_level": 4, "backend": "numpy"}
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
    options = {"max_level": 4, "backend": "numpy"}
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

    options = {"max_level": 4, "backend": "numpy", "checkpoint": tmp_path / "kept"}
    started = time.monotonic()
    with pytest.raises(SynthesisError, match="the Dask scheduler was lost"):
        capsyn.synthesize(PROBLEM, executor=client, progress=kill, **options)
    assert time.monotonic() - started < 30
    whole = capsyn.synthesize(PROBLEM, **options)  # goes on without
    del options["checkpoint"]
    assert file_of(whole, tmp_path) == file_of(capsyn.synthesize(PROBLEM, **options), tmp_path)


def test_an_interrupt_does_not_wait_for_workers(other, tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoint, "INTERVAL", 1e9)  # only the end writes a block, not the clock
    client, workers, _ = other({})
    interrupt = threading.Timer(0.3, os.kill, [os.getpid(), signal.SIGINT])

    def stop(progress):
        if progress.level == 1 and not interrupt.ident:  # once: a second one would cut off the end
            workers[0].send_signal(signal.SIGSTOP)
            interrupt.start()

    options = {"max_level": 3, "backend": "numpy", "checkpoint": tmp_path / "kept"}
    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        capsyn.synthesize(PROBLEM, executor=client, progress=stop, **options)
    assert time.monotonic() - started < 10
    assert len(list((tmp_path / "kept").glob("block-*"))) == 1
    capsyn.synthesize(PROBLEM, **options)  # nobody holds the checkpoint


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


@pytest.mark.skipif(platform.machine() != "x86_64", reason="needs fused operations to turn off")
def test_a_worker_with_other_bits_is_refused(other, monkeypatch):
    monkeypatch.setattr(cluster.Workers, "submit", None)  # before any work
    client, *_ = other({"CC": "cc -mno-avx2 -mno-fma"})
    with pytest.raises(ProblemError, match="its results have other bits: its compiler is .*-fma"):
        capsyn.synthesize(PROBLEM, max_level=2, executor=client)

    with pytest.raises(ProblemError, match="its results have other bits: its compiler is .*-fma"):
        monte_carlo(client)


def test_a_worker_that_comes_late_is_checked_when_it_works(client, monkeypatch):
    monkeypatch.setattr(cluster.Workers, "_check", lambda self, found: None)
    monkeypatch.setattr(cluster, "digest", lambda arrays: "another")
    monkeypatch.setattr(cluster, "_kept", type(cluster._kept)())
    with pytest.raises(ProblemError, match=r"worker tcp://.* cannot take part: .* other bits"):
        capsyn.synthesize(PROBLEM, max_level=1, executor=client)


def test_another_version_is_refused(client, monkeypatch):
    monkeypatch.setattr(cluster, "__version__", "7.7")
    with pytest.raises(ProblemError, match=r"it has capsyn 0\.1\.0, the process that asks 7\.7"):
        capsyn.synthesize(PROBLEM, max_level=1, executor=client)


def test_a_worker_without_capsyn_is_refused(other, tmp_path):
    (tmp_path / "capsyn").mkdir()
    (tmp_path / "capsyn" / "__init__.py").write_text("raise ImportError('no capsyn here')")
    client, *_ = other({"PYTHONPATH": str(tmp_path)})
    with pytest.raises(ProblemError, match="worker tcp://.* cannot take part: .*no capsyn here"):
        capsyn.synthesize(PROBLEM, max_level=1, executor=client)


def test_a_scheduler_without_workers_is_refused(other, monkeypatch):
    client, *_ = other()
    monkeypatch.setattr(cluster, "CONNECT_SECONDS", 0.3)
    with pytest.raises(
        ProblemError, match="Dask scheduler at 'tcp://127.0.0.1:[0-9]+' has no work"
    ):
        capsyn.synthesize(PROBLEM, max_level=1, executor=client)


def free_address():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return f"tcp://127.0.0.1:{found.getsockname()[1]}"


def command(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "capsyn", *arguments], capture_output=True, text=True
    )


def test_an_unreachable_scheduler_fails_within_ten_seconds(monkeypatch):
    assert cluster.CONNECT_SECONDS < 8
    monkeypatch.setattr(cluster, "CONNECT_SECONDS", 1.0)
    address, started = free_address(), time.monotonic()
    with pytest.raises(ProblemError, match=f"no Dask scheduler answers at '{address}'"):
        with cluster.connect(address):
            pass
    assert time.monotonic() - started < 3


@pytest.mark.parametrize("address", ["local:", "local:two", "local:0", "what is this", "ftp://a:1"])
def test_an_address_that_is_none(address):
    with pytest.raises(ProblemError, match=f"{address.rstrip(':02two')}"):
        with cluster.connect(address):
            pass


def test_what_is_no_client_is_refused(monkeypatch, address):
    with pytest.raises(ProblemError, match="`executor` must be a dask.distributed.Client"):
        capsyn.synthesize(PROBLEM, executor="tcp://127.0.0.1:8786")
    closed = distributed.Client(address)
    closed.close()
    with pytest.raises(ProblemError, match="must be connected; .*closed"):
        capsyn.synthesize(PROBLEM, executor=closed)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ProblemError, match=r"pip install 'capsyn\[distributed\]'"):
        with cluster.connect("local:1"):
            pass


@pytest.fixture(scope="module")
def policy():
    return capsyn.synthesize(problems.plain("cart-pendulum"), max_level=3)


def monte_carlo(executor, policy=None, **options):
    policy = policy or capsyn.synthesize(problems.plain("cart-pendulum"), max_level=2)
    return capsyn.monte_carlo(
        policy, **{"trials": 500, "duration": 4.0, "executor": executor, **options}
    )


def pendulum(x, u, p):
    return [x[1], 9.81 * np.sin(1) * x[0] - p[0] * x[1] + u[0]]


@pytest.mark.parametrize("backend", ["c", "numpy"])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {
            "noise": [0.01, 0.02],
            "delay": capsyn.Uniform(0.0, 0.004),
            "disturbance": lambda t: [0.0, 0.1 * np.sin(t)],
            "model": pendulum,
            "parameters": {"friction": capsyn.Uniform(0.0, 0.1)},
            "outside": "nearest",
            "hold": 0.5,
            "min_dwell": 0.01,
        },
    ],
    ids=["plain", "everything"],
)
def test_monte_carlo_is_the_same(client, policy, backend, options):
    options = {"backend": backend, "trials": 500 if backend == "c" else 60, **options}
    if backend == "numpy":
        options |= {"duration": 1.0, "rate": 200.0, "hold": 0.0}
    local, remote = monte_carlo(None, policy, **options), monte_carlo(client, policy, **options)
    assert local.to_json() == remote.to_json()
    for name in ("initial", "final", "ended", "times", "arrived", "switches", "outside"):
        assert getattr(local, name).tobytes() == getattr(remote, name).tobytes()


def test_monte_carlo_goes_on_when_a_worker_is_killed(other, policy, monkeypatch):
    client, workers, _ = other({}, {})
    local = monte_carlo(None, policy, trials=4000)
    take = cluster.Workers.result

    def result(self, future):
        workers[0].kill()
        return take(self, future)

    monkeypatch.setattr(cluster.Workers, "result", result)
    remote = monte_carlo(client, policy, trials=4000)
    assert local.to_json() == remote.to_json()
    assert local.final.tobytes() == remote.final.tobytes()


def test_monte_carlo_sends_no_functions(client, policy):
    with pytest.raises(ProblemError, match="`executor` needs a Policy"):
        capsyn.monte_carlo(
            lambda time, states: np.zeros((len(states), 1)),
            target=policy.target,
            model=problems.plain("cart-pendulum"),
            rate=100.0,
            executor=client,
        )


def test_the_commands(address, tmp_path, policy):
    whole = file_of(policy, tmp_path)
    for name in (address, "local:1"):
        path = tmp_path / "remote.cap"
        plain = ["--max-level", "3", "--switch-price", "none"]
        run = command("synth", "cart-pendulum", *plain, "-o", path, "--dask", name)
        assert run.returncode == 0 and not run.stderr, run.stderr
        assert path.read_bytes() == whole
    verify = ["verify", str(path), "--dask", address]
    run = CliRunner().invoke(app, [*verify, "--monte-carlo", "200", "--json"])
    assert (
        json.loads(run.stdout)["monte_carlo"]
        == monte_carlo(None, policy, trials=200, duration=20.0).to_json()
    )
    run = CliRunner().invoke(app, [*verify, "--agreement", "200"])
    assert run.exit_code and "--dask needs --monte-carlo" in str(run.exception)
