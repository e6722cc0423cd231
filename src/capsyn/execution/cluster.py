"""Work on the workers of a Dask cluster, who must all compute the same bits as this process.

What is sent is plain data, from which every worker builds its kernels once. Before it works, a
worker solves a probe, and is refused where a single bit differs from what this process gets.
"""

from __future__ import annotations

import collections
import contextlib
import functools
import hashlib
import pickle
import platform
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import CapsynError, KernelBuildError, ProblemError, SynthesisError, warn
from capsyn.execution.answers import digest
from capsyn.native.build import processor_name
from capsyn.native.compiler import find_compiler
from capsyn.validation import describe, one_line, whole_number
from capsyn.version import __version__

CONNECT_SECONDS = 6.0
"""Time in which a scheduler must answer, and a first worker must be there [s]."""
RETRIES = 3
"""Times that a batch is tried again where it failed."""
AHEAD = 3
"""Batches per thread of the workers that are under way: one at work, the others on their way."""
ASK_SECONDS = 5.0
"""Time after which the workers are counted again [s]."""
KEPT_JOBS = 8
"""Jobs whose kernels a worker keeps."""

Work = Callable[[Any], Any]
Build = Callable[[Any], tuple[Work, Callable[[], tuple[np.ndarray, ...]]]]
"""Plain data to what works on a batch, and what solves the probe."""


@dataclass(frozen=True)
class Job:
    """Work for others: a function of this package, and the plain data that it is called with."""

    build: Build
    plain: Any

    @functools.cached_property
    def key(self) -> str:
        """A hash of the job."""
        return hashlib.sha256(pickle.dumps((self.build, self.plain), protocol=5)).hexdigest()


@contextlib.contextmanager
def connect(address: str) -> Iterator[Any]:
    """Yield the client of a Dask scheduler, or of ``local:N`` worker processes made for it.

    It is a `ProblemError` where the address is none, or nobody answers within `CONNECT_SECONDS`.
    """
    import asyncio

    distributed = _distributed()
    start, _, count = address.partition(":")
    if start == "local":
        try:
            workers = int(count)
        except ValueError:
            raise ProblemError(
                f"`dask` must be an address or local:N of N workers; got '{address}'"
            ) from None
        workers = whole_number("dask local:N", workers, least=1)
        with _deaf_to_interrupts():
            cluster = distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, dashboard_address=":0"
            )
        with cluster, distributed.Client(cluster) as client:
            yield client
        return

    async def knock() -> None:  # a client that fails would keep the process for long when it ends
        security = distributed.Security().get_connection_args("client")
        comm = await distributed.core.connect(address, timeout=CONNECT_SECONDS, **security)
        await comm.close()

    try:
        asyncio.run(knock())
        client = distributed.Client(address, timeout=CONNECT_SECONDS)
    except (OSError, ValueError, TypeError, asyncio.TimeoutError) as error:
        reason = one_line(str(error) or type(error).__name__)
        raise ProblemError(f"no Dask scheduler answers at '{address}': {reason}") from None
    with client:
        yield client


@contextlib.contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Let processes that start now ignore Ctrl-C: it is for the one that ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise ProblemError(
            "Dask is not installed; it comes with the extra: pip install 'capsyn[distributed]'"
        ) from None
    return distributed


def check_client(executor: Any) -> None:
    """Raise `ProblemError` unless `executor` is a connected Dask client with workers."""
    import asyncio

    distributed = _distributed()
    if not isinstance(executor, distributed.Client) or executor.asynchronous:
        raise ProblemError(
            f"`executor` must be a dask.distributed.Client that is not asynchronous; "
            f"got {describe(executor)}"
        )
    if executor.status != "running":
        raise ProblemError(
            f"`executor` must be connected; the client's status is {executor.status}"
        )
    try:
        executor.wait_for_workers(1, timeout=CONNECT_SECONDS)
    except (OSError, asyncio.TimeoutError):
        address = executor.scheduler.address if executor.scheduler else "?"
        raise ProblemError(f"the Dask scheduler at '{address}' has no workers") from None


class Workers:
    """The workers of a client, checked for a job. Safe to use from threads.

    `check_client` has seen the client. `job_of` gives the job for the backend "c" or "numpy";
    `backend` is what was asked for. `used` is what this process would take, and then what all take.
    A worker that would give other results is a `ProblemError`: it has another version or backend,
    or its solutions of the probe differ.
    """

    def __init__(self, client: Any, job_of: Callable[[str], Job], backend: str, used: str) -> None:
        self._client, self.used = client, used
        self._threads, self._asked = 1, -np.inf
        reports = self._inspect(job_of(used))
        lacking = {who: report["lacks"] for who, report in reports.items() if "lacks" in report}
        if lacking and backend == "auto" and len(lacking) == len(reports):
            self.used = "numpy"
            who, reason = min(lacking.items())
            warn(f"all workers solve with NumPy, and so does this process: worker {who}: {reason}")
            reports = self._inspect(job_of("numpy"))
        elif lacking:
            who, reason = min(lacking.items())
            advice = "" if backend == "c" else '; with backend "numpy" all can take part'
            raise ProblemError(f"worker {who} cannot take part: {reason}{advice}")
        self._check(reports)
        self._plain = client.submit(_same, self._job.plain, key=f"capsyn-job-{self._job.key}")

    def _inspect(self, job: Job) -> dict[str, dict[str, Any]]:
        """Let every worker build the job, and return what they report."""
        self._job = job
        self._expected = _ready(job.build, job.key, job.plain)[1]
        reports = self._client.run(
            _report, job.build, job.key, job.plain, __version__, on_error="return"
        )
        for who, report in reports.items():
            if isinstance(report, BaseException):
                reason = one_line(f"{type(report).__name__}: {report}")
                raise ProblemError(f"worker {who} cannot take part: {reason}")
        return reports

    def _check(self, reports: dict[str, dict[str, Any]]) -> None:
        own = about()
        for who, report in sorted(reports.items()):
            if "capsyn" in report:
                raise ProblemError(_other_version(who, report["capsyn"], __version__))
            if report["probe"] != self._expected:
                raise ProblemError(_difference(who, report["about"], own))

    @property
    def threads(self) -> int:
        """Threads of the workers that are there now, or were a few seconds ago; at least 1."""
        now = time.monotonic()
        if now - self._asked > ASK_SECONDS:
            self._asked = now
            with contextlib.suppress(Exception):  # where it is lost, `result` tells
                self._threads = max(1, sum(self._client.nthreads().values()))
        return self._threads

    @property
    def slots(self) -> int:
        """How many batches should be under way."""
        return AHEAD * self.threads

    def submit(self, batch: Any) -> Any:
        """Return the Dask future of what the job makes of a batch."""
        job = self._job
        return self._client.submit(
            _work, job.build, job.key, self._plain, __version__, self._expected, batch,
            pure=False, retries=RETRIES,
        )  # fmt: skip

    def result(self, future: Any) -> Any:
        """Return what a future holds, once it is done; errors are those of capsyn."""
        try:
            return future.result()
        except CapsynError:
            raise
        except Exception as error:  # of Dask, or whatever a worker may run into
            reason = one_line(str(error) or type(error).__name__)
            what = (
                "the cluster failed" if future.status == "error" else "the Dask scheduler was lost"
            )
            raise SynthesisError(f"{what}: {reason}") from error

    def map(self, batches: Iterable[Any]) -> Iterator[Any]:
        """Yield what the job makes of batches, in their order."""
        waiting: collections.deque[Any] = collections.deque()
        for batch in batches:
            waiting.append(self.submit(batch))
            if len(waiting) >= self.slots:
                yield self.result(waiting.popleft())
        while waiting:
            yield self.result(waiting.popleft())


def about() -> dict[str, str]:
    """Return what of this machine results may depend on, in words."""
    try:
        tool = find_compiler()
        compiler = " ".join([tool.version, *tool.command[1:]])
    except KernelBuildError:
        compiler = "none"
    return {
        "compiler": compiler,
        "C library": " ".join(platform.libc_ver()).strip(),
        "NumPy": np.__version__,
        "machine": platform.machine(),
        "processor": processor_name(),
    }


def _difference(who: str, theirs: dict[str, str], own: dict[str, str]) -> str:
    differences = [
        f"its {key} is {theirs.get(key)}, not {value}"
        for key, value in own.items()
        if theirs.get(key) != value
    ]
    reason = "; ".join(differences) or ", ".join(f"its {k} is {v}" for k, v in theirs.items())
    return one_line(f"worker {who} cannot take part: its results have other bits: {reason}", 400)


_lock = threading.Lock()
_kept: collections.OrderedDict[str, tuple[Work, str]] = collections.OrderedDict()


def _ready(build: Build, key: str, plain: Any) -> tuple[Work, str]:
    """Return what works on a job's batches, and the digest of its probe; built once."""
    with _lock:
        if key not in _kept:
            work, probe = build(plain)
            arrays = {str(i): array for i, array in enumerate(probe())}
            _kept[key] = work, digest(arrays)
            while len(_kept) > KEPT_JOBS:
                _kept.popitem(last=False)
        _kept.move_to_end(key)
        return _kept[key]


async def _report(build: Build, key: str, plain: Any, version: str) -> dict[str, Any]:
    """Return, on a worker, how it does with a job."""
    import asyncio

    if __version__ != version:
        return {"capsyn": __version__}
    try:
        _, probe = await asyncio.to_thread(_ready, build, key, plain)
    except KernelBuildError as error:
        return {"lacks": one_line(str(error))}
    return {"probe": probe, "about": about()}


def _work(build: Build, key: str, plain: Any, version: str, expected: str, batch: Any) -> Any:
    """Return, on a worker, what a job makes of a batch; one that came late is checked here."""
    if __version__ != version:
        raise ProblemError(_other_version(_own_address(), __version__, version))
    try:
        work, probe = _ready(build, key, plain)
    except KernelBuildError as error:
        raise ProblemError(f"worker {_own_address()} cannot take part: {error}") from None
    if probe != expected:
        raise ProblemError(_difference(_own_address(), about(), {}))
    return work(batch)


def _own_address() -> str:
    from distributed import get_worker

    return str(get_worker().address)


def _other_version(who: str, theirs: str, own: str) -> str:
    return f"worker {who} cannot take part: it has capsyn {theirs}, the process that asks {own}"


def _same(plain: Any) -> Any:
    """Return plain data: a task, so that workers who lose it get it again."""
    return plain
