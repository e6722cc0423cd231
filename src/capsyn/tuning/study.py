"""The search itself: an Optuna study of settings, which may be resumed and shared."""

from __future__ import annotations

import contextlib
import json
import math
import os
import platform
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import psutil

from capsyn.errors import CapsynWarning, ProblemError, SynthesisError
from capsyn.random_streams import derived_seed
from capsyn.tuning.figures import Figures, Tried
from capsyn.tuning.free import Free
from capsyn.tuning.goal import Goal
from capsyn.validation import describe, one_line

try:
    import optuna
except ImportError:
    raise ProblemError("`tune` needs Optuna: pip install 'capsyn[tune]'") from None

STARTUP = 10
"""Settings that spread over the ranges before the search follows what was found."""
ASKED, FIGURES, ERROR = "capsyn", "figures", "error"
"""Attributes: what was asked of a study; what a trial found, why it found nothing."""
OWNER, BEGUN = "owner", "begun"
"""Attributes of a trial: who runs it, and how many times that was begun."""
MOST_BEGUN = 2
"""Times that settings may end the process that tries them."""
SAMPLING = 22
"""Purpose of the seeds of settings."""
HOST = platform.node().replace(" ", "")
"""Machine on which trials run."""
JOURNALS = (".journal", ".log")
"""Endings of storages that are journals; others are SQLite files."""


Stages = Callable[[dict[str, Any]], Sequence[Callable[[], Figures]]]
"""Of settings, what judges them, one stage after the other, in full last."""


class Study:
    """A search for settings, in memory or in a storage.

    Parameters
    ----------
    name : str
        Of the study in its storage.
    free : mapping of name to Free
        What is searched.
    goal : Goal
        What is wanted.
    asked : mapping of text to text
        What a study that goes on must have in common with this one, in words.
    storage : path or URL, optional
        Where trials are kept: a file, or a database as Optuna takes them. None: in memory.
    seed : int
        Of the settings that are tried.

    Raises
    ------
    ProblemError
        A storage that cannot be used, or that holds another study of this name.
    """

    def __init__(
        self,
        name: str,
        free: Mapping[str, Free],
        goal: Goal,
        asked: Mapping[str, str],
        storage: Any,
        seed: int,
    ) -> None:
        self.free, self.goal, self.storage = dict(free), goal, storage
        with _quietly():
            try:
                self._study = optuna.create_study(
                    storage=_storage(storage),
                    study_name=name,
                    directions=["minimize"] * len(goal.axes),
                    sampler=_Sampler(free, seed),
                    pruner=optuna.pruners.MedianPruner(n_startup_trials=STARTUP // 2),
                    load_if_exists=True,
                )
            except Exception as error:  # of databases: many kinds
                raise ProblemError(
                    f"`storage` cannot be used: {describe(str(storage))}: "
                    f"{one_line(str(error)) or type(error).__name__}"
                ) from error
            self._check(asked)

    def _check(self, asked: Mapping[str, str]) -> None:
        known = self._study.user_attrs.get(ASKED)
        if known is None:
            if self._study.get_trials(deepcopy=False):
                raise ProblemError(
                    f"`storage` '{self.storage}' has a study of this name that capsyn did not make"
                )
            self._study.set_user_attr(ASKED, dict(asked))
            return
        for what, value in asked.items():
            if known.get(what) != value:
                raise ProblemError(
                    f"the study in '{self.storage}' has another {what}: {known.get(what)}; got "
                    f"{value}; give another storage, or the same {what}"
                )

    def search(self, count: int, stages: Stages, progress: Callable[[str], None] | None) -> None:
        """Try settings until the study has `count`; those that cannot be used count, too.

        A trial that is interrupted does not count, and is the first when the study goes on.
        """
        with _quietly():
            while (done := len(self.tried())) < count:
                if progress is not None:
                    progress(f"settings {done + 1} of {count}")
                # another process may go on with what was left, too, and be first with the same
                with contextlib.suppress(optuna.exceptions.UpdateFinishedTrialError):
                    self._try(self._left() or self._asked(), stages)

    def _asked(self) -> Any:
        """Return the next trial, which has its owner from the moment it is in the storage."""
        self._study.enqueue_trial({}, user_attrs={OWNER: f"{HOST} {os.getpid()}"})
        return self._study.ask()

    def _left(self) -> Any:
        """Return a trial that was begun by a process of this machine that is no more, or None."""
        for trial in self._study.get_trials(False, (optuna.trial.TrialState.RUNNING,)):
            owner = str(trial.user_attrs.get(OWNER, f"{HOST} {os.getpid()}"))
            host, _, process = owner.partition(" ")
            if host == HOST and not (process.isdigit() and psutil.pid_exists(int(process))):
                return optuna.trial.Trial(self._study, trial._trial_id)
        return None

    def _try(self, trial: Any, stages: Stages) -> None:
        ends = optuna.trial.TrialState
        trial.set_user_attr(OWNER, f"{HOST} {os.getpid()}")
        begun = int(trial.user_attrs.get(BEGUN, 0)) + 1
        trial.set_user_attr(BEGUN, begun)
        found = {name: _suggested(trial, name, free) for name, free in self.free.items()}
        settings = {name: self.free[name].value(value) for name, value in found.items()}
        values: list[float] = []
        try:
            if begun > MOST_BEGUN:
                raise ProblemError(f"the process ended {MOST_BEGUN} times on the way")
            judges = stages(settings)
            for step, judge in enumerate(judges):
                figures = judge()
                trial.set_user_attr(FIGURES, json.dumps(figures.to_json()))
                values = self.goal.objectives(figures)
                if len(values) == 1:  # no study of several objectives ends trials early
                    trial.report(values[0], step)
                    if step < len(judges) - 1 and trial.should_prune():
                        self._study.tell(trial, state=ends.PRUNED, skip_if_finished=True)
                        return
            self._study.tell(trial, values, skip_if_finished=True)
        except (ProblemError, SynthesisError) as error:
            trial.set_user_attr(ERROR, one_line(str(error)))
            self._study.tell(trial, state=ends.FAIL, skip_if_finished=True)
        except BaseException:
            trial.set_user_attr(OWNER, f"{HOST} ")  # whoever goes on begins with it
            trial.set_user_attr(BEGUN, begun - 1)
            raise

    def tried(self) -> list[Tried]:
        """Return the settings that were tried, in order."""
        found = []
        for trial in self._study.get_trials(deepcopy=False):
            error, text = trial.user_attrs.get(ERROR), trial.user_attrs.get(FIGURES)
            ended = trial.state.name in ("COMPLETE", "PRUNED")
            if not ended and error is None:
                continue
            settings = {n: f.value(trial.params[n]) for n, f in self.free.items()}
            figures = Figures.from_json(_parsed(text)) if ended and text else None
            full = trial.state.name == "COMPLETE" and figures is not None
            found.append(Tried(trial.number, settings, figures, full, error))
        return found


class _Sampler(optuna.samplers.BaseSampler):
    """Settings for trials by their number: the same however often a study is resumed.

    The first is the middle of all ranges; those of the start spread evenly over them, by an
    additive recurrence; then the tree-structured Parzen estimator follows what was found.
    """

    def __init__(self, free: Mapping[str, Free], seed: int) -> None:
        self.free, self.seed = dict(free), seed

    def infer_relative_search_space(self, study: Any, trial: Any) -> dict[str, Any]:
        return {name: _distribution(free) for name, free in self.free.items()}

    def sample_relative(self, study: Any, trial: Any, search_space: Any) -> dict[str, Any]:
        k = trial.number
        found: dict[str, Any] = {}
        if k >= STARTUP:
            own = optuna.samplers.TPESampler(
                seed=derived_seed(self.seed, SAMPLING, k) % 2**32,
                multivariate=True,
                n_startup_trials=2,
            )
            found = own.sample_relative(study, trial, search_space)
        return found or self._spread(k)

    def _spread(self, k: int) -> dict[str, Any]:
        count = len(self.free)
        ratio = 2.0
        for _ in range(50):  # the root of ratio^(count + 1) = ratio + 1
            ratio = (1 + ratio) ** (1 / (count + 1))
        shares = [math.fmod(0.5 + k * ratio ** -(i + 1), 1.0) for i in range(count)]
        free = self.free.items()
        if k == 0:
            shares = [0.0 if one.choices is not None else 0.5 for one in self.free.values()]
        return {name: one.at(share) for (name, one), share in zip(free, shares)}

    def sample_independent(
        self, study: Any, trial: Any, param_name: str, param_distribution: Any
    ) -> Any:
        return self._spread(trial.number)[param_name]


def _distribution(free: Free) -> Any:
    if free.choices is not None:
        return optuna.distributions.CategoricalDistribution(tuple(free.choices))
    return optuna.distributions.FloatDistribution(*free.bounds, log=bool(free.log))


def _suggested(trial: Any, name: str, free: Free) -> Any:
    if free.choices is not None:
        return trial.suggest_categorical(name, free.choices)
    low, high = free.bounds
    return trial.suggest_float(name, low, high, log=free.log)


def _storage(storage: Any) -> Any:
    """Return what Optuna takes as storage: for a file a journal or SQLite, else the URL."""
    if storage is None or "://" in str(storage):
        return storage
    path = str(storage)
    if path.endswith(JOURNALS):
        from optuna.storages import JournalStorage
        from optuna.storages.journal import JournalFileBackend

        return JournalStorage(JournalFileBackend(path))
    return f"sqlite:///{path}"


def _parsed(text: Any) -> Any:
    """Return what JSON says, None where it is none."""
    try:
        return json.loads(text)
    except (TypeError, ValueError, RecursionError):
        return None


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    """Let Optuna say nothing but errors, and trials no warnings, for a while."""
    level = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CapsynWarning)
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            yield
    finally:
        optuna.logging.set_verbosity(level)
