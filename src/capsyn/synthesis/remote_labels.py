"""A labelling function that asks the workers of a cluster."""

from __future__ import annotations

import collections
import threading
from concurrent.futures import Future
from typing import Any

import numpy as np

from capsyn.errors import SynthesisError
from capsyn.execution.answers import Answer, Packed
from capsyn.execution.cluster import Workers

IN_FLIGHT = 128
"""Chunks that wait for their answers at a time, each in a thread of its own."""
BATCH_BYTES = 1 << 22
"""Size of the states that are sent at once."""


class RemoteLabels:
    """A labelling function for `IN_FLIGHT` threads: chunks that wait travel together.

    Workers answer chunk by chunk, so the answers are those of a local call for each.
    """

    def __init__(self, workers: Workers) -> None:
        self._workers = workers
        self._guard = threading.Lock()
        self._queue: collections.deque[tuple[np.ndarray, Future[Answer]]] = collections.deque()
        self._open: set[Future[Answer]] = set()
        self._under_way = 0
        self._closed = False

    def __call__(self, states: np.ndarray) -> Answer:
        """Return the answer for states (B, n)."""
        answer: Future[Answer] = Future()
        with self._guard:
            if self._closed:
                raise SynthesisError("the run has ended")
            self._queue.append((states, answer))
            self._open.add(answer)
        self._send()
        return answer.result()

    def close(self) -> None:
        """Let threads that still wait go, with an error."""
        with self._guard:
            self._closed = True
            self._queue.clear()
            waiting = list(self._open)
        self._fail(waiting, SynthesisError("the run has ended"))

    def _send(self) -> None:
        """Send what waits, in as many batches as workers have use for."""
        slots = self._workers.slots
        while batch := self._next_batch(slots):
            answers = [answer for _, answer in batch]
            try:
                states = np.concatenate([chunk for chunk, _ in batch])
                task = self._workers.submit((states, [len(chunk) for chunk, _ in batch]))
                task.add_done_callback(lambda task, answers=answers: self._receive(task, answers))
            except BaseException as error:  # the threads that wait raise it
                self._fail(answers, error)
                with self._guard:
                    self._under_way -= 1

    def _next_batch(self, slots: int) -> list[tuple[np.ndarray, Future[Answer]]]:
        with self._guard:
            free = slots - self._under_way
            if free <= 0 or not self._queue:
                return []
            share = -(-len(self._queue) // free)
            batch: list[tuple[np.ndarray, Future[Answer]]] = []
            size = 0
            while self._queue and len(batch) < share and size < BATCH_BYTES:
                batch.append(self._queue.popleft())
                size += batch[-1][0].nbytes
            self._under_way += 1
            return batch

    def _receive(self, task: Any, answers: list[Future[Answer]]) -> None:
        """Hand out the answers of a batch that is done, and send the next."""
        try:
            packed: Packed = self._workers.result(task)
            values = packed.answers()
            with self._guard:
                for answer, value in zip(answers, values, strict=True):
                    if not answer.done():
                        answer.set_result(value)
                self._open.difference_update(answers)
        except BaseException as error:
            self._fail(answers, error)
        with self._guard:
            self._under_way -= 1
        self._send()

    def _fail(self, answers: list[Future[Answer]], error: BaseException) -> None:
        with self._guard:
            for answer in answers:
                if not answer.done():
                    answer.set_exception(error)
            self._open.difference_update(answers)
