"""Gymnasium: policies play its environments, and problems become environments."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.integrations.evaluation import Evaluation
from capsyn.integrations.single_lookup import single_lookup
from capsyn.integrations.stepping import has_holds, has_memory, stepper
from capsyn.modelling.discrete import horizon_time
from capsyn.modelling.exogenous import one_exogenous
from capsyn.modelling.problem import Problem
from capsyn.modelling.targets import target_program
from capsyn.modelling.time_unit import NAMES
from capsyn.policies.policy import Policy
from capsyn.random_streams import derived_seed
from capsyn.simulation.closed_loop import SLACK
from capsyn.simulation.plant import choose_substeps, plant_of
from capsyn.sources.callables import foreign
from capsyn.validation import describe, finite_array, finite_number, numbers, one_line, whole_number

try:
    import gymnasium
except ImportError:
    raise ProblemError(
        "`capsyn.integrations.gymnasium` needs Gymnasium: pip install 'capsyn[gymnasium]'"
    ) from None

PLAYING = 8
"""Purpose of the seeds of episodes."""
HORIZONS = 10
"""Length of an episode of a problem, in prediction horizons."""
MOST_SAMPLES = 1_000_000_000
"""Most samples of an episode of a problem."""
WORST_REWARD = -1e30
"""Least reward of a problem's sample; finite in single precision too."""


class Player:
    """The actions of a policy in an environment, observation after observation; see `player`."""

    def __init__(
        self, policy: Policy, period: float, state: Callable[[Any], np.ndarray], table: list[Any]
    ) -> None:
        self._policy, self._state, self._table = policy, state, table
        self._look_up = single_lookup(policy)
        timed = np.isfinite(period) and bool(policy.rules.holds.any())
        self._step = stepper(policy, period) if has_memory(policy) or timed else None
        self.reset()

    def reset(self) -> None:
        """Begin an episode, with no symbol in force."""
        self._memory = np.zeros(2 + self._policy.alphabet.m)

    def __call__(self, observed: Any) -> Any:
        """Return the action for an observation."""
        state = self._state(observed)
        if self._step is None:
            symbol = self._look_up(state)
        else:
            symbol, self._memory = self._step(state, self._memory)
        if symbol < 0 and len(self._table) == len(self._policy.alphabet):
            raise ProblemError(
                "`actions` must have an entry for the default control, which the policy gives at "
                f"state {state.tolist()}"
            )
        return self._table[symbol]


def player(
    policy: Policy,
    env: gymnasium.Env,
    *,
    observation: Callable[[Any], Any] | None = None,
    actions: Sequence[Any] | None = None,
    period: float | None = None,
) -> Player:
    """Return a function that chooses an environment's action from its observation, by a policy.

    If the policy remembers, the function keeps the symbol in force from call to call. Its method
    ``reset`` begins an episode.

    Parameters
    ----------
    policy : Policy
        The policy, with its rule outside the domain and its switching.
    env : gymnasium.Env
        An environment with ``Discrete`` or ``Box`` actions.
    observation : callable, optional
        A function from the observation to the state (n,), followed by exogenous inputs if the
        policy is told some. Default: the flat observation.
    actions : N or N + 1 actions, optional
        The action of each symbol, and perhaps of the default control. Default for ``Discrete``: the
        symbol's index, counted from the first action, and no action for the default control.
        Default for ``Box``: the control vector.
    period : float, optional
        Time of a step [time unit of the policy], in which least times are counted. Default: that of
        an `environment`, if the policy's `Switching` has least times.

    Raises
    ------
    ProblemError
        The spaces do not fit the policy, or an action is not in the environment. When called: an
        observation gives no state, or the default control has no action.
    """
    if not isinstance(policy, Policy):
        raise ProblemError(f"`policy` must be a capsyn.Policy; got {describe(policy)}")
    if not isinstance(env, gymnasium.Env):
        raise ProblemError(f"`env` must be a gymnasium.Env; got {describe(env)}")
    n, count, space = policy.space.n, len(policy.alphabet), getattr(env, "action_space", None)
    if not isinstance(space, gymnasium.Space):
        raise ProblemError(f"`env` must have a space of actions; got {describe(space)}")
    if observation is None:
        seen = getattr(env, "observation_space", None)
        if not isinstance(seen, gymnasium.spaces.Box) or np.prod(seen.shape, dtype=int) != n:
            raise ProblemError(
                f"`observation` must be given where observations are not {n} numbers; got {seen}"
            )
    elif not callable(observation):
        raise ProblemError(f"`observation` must be a function; got {describe(observation)}")
    try:
        table = _actions(policy, space) if actions is None else list(actions)
    except TypeError:
        raise ProblemError(
            f"`actions` must be a list of actions; got {describe(actions)}"
        ) from None
    if len(table) not in (count, count + 1):
        raise ProblemError(
            f"`actions` must have {count} entries, or {count + 1} with that of the default "
            f"control; got {len(table)}"
        )
    for k, action in enumerate(table):
        if not space.contains(action):
            name = policy.symbol_name(k if k < count else -1)
            raise ProblemError(
                f"the action {describe(action)} of symbol '{name}' is not in {one_line(str(space))}"
            )

    def state(observed: Any) -> np.ndarray:
        seen = observed
        if observation is not None:
            with foreign("`observation` failed"):
                seen = observation(observed)
        array = numbers("observation", seen)
        array = array.reshape(-1) if observation is None else array
        if array.shape != (n,):
            raise ProblemError(f"`observation` must give {n} numbers; got {describe(seen)}")
        return array

    return Player(policy, _period(policy, env, period), state, table)


def _period(policy: Policy, env: gymnasium.Env, period: float | None) -> float:
    """Return the time of a step [time unit], infinite where no least times are kept."""
    if period is not None:
        return finite_number("period", period, above=0.0)
    if not has_holds(policy):
        return np.inf
    if isinstance(env.unwrapped, Environment):
        return env.unwrapped.period
    raise ProblemError(
        "`period` must be given, the time of a step of `env`, to keep the least times of the policy"
    )


def _actions(policy: Policy, space: Any) -> list[Any]:
    """Return the actions that symbols have unless told."""
    count = len(policy.alphabet)
    if isinstance(space, gymnasium.spaces.Discrete):
        if count > space.n:
            raise ProblemError(
                f"`actions` must be given: the policy has {count} symbols, the environment "
                f"{space.n} actions"
            )
        return [space.dtype.type(space.start + k) for k in range(count)]
    if isinstance(space, gymnasium.spaces.Box):
        if np.prod(space.shape, dtype=int) != policy.alphabet.m:
            raise ProblemError(
                f"`actions` must be given: controls have {policy.alphabet.m} components, actions "
                f"the shape {space.shape}"
            )
        actions = [row.reshape(space.shape).astype(space.dtype) for row in policy.controls]
        return actions if space.contains(actions[-1]) else actions[:-1]
    raise ProblemError(f"`env` must have Discrete or Box actions; got {space}")


def evaluate(
    policy: Policy,
    env: Any,
    episodes: int = 100,
    seed: int = 0,
    *,
    observation: Callable[[Any], Any] | None = None,
    actions: Sequence[Any] | None = None,
    period: float | None = None,
) -> Evaluation:
    """Return the results of a policy in episodes of an environment.

    Parameters
    ----------
    policy : Policy
        The policy.
    env : gymnasium.Env or str
        An environment whose episodes end, or the name of a registered one.
    episodes : int
        Number of episodes. Each has its own seed, so the first ones do not depend on the number.
    seed : int
        Seed of all episodes.
    observation, actions, period
        Arguments of `player`.

    Raises
    ------
    ProblemError
        An argument cannot be used; see `player`. An error of the environment is the ``__cause__``.
    """
    episodes = whole_number("episodes", episodes, least=1, most=10_000_000)
    seed = whole_number("seed", seed, least=0)
    with contextlib.ExitStack() as stack:
        if isinstance(env, str):
            with foreign(f"`env` must be a registered environment; got {describe(env)}"):
                env = gymnasium.make(env)
            stack.callback(env.close)
        act = player(policy, env, observation=observation, actions=actions, period=period)
        seeds = [derived_seed(seed, PLAYING, k) % 2**31 for k in range(episodes)]
        played = [_episode(act, env, seed) for seed in seeds]
    returns, lengths, terminated = zip(*played)
    return Evaluation(np.array(returns), np.array(lengths), np.array(terminated))


def _episode(act: Player, env: gymnasium.Env, seed: int) -> tuple[float, int, bool]:
    with foreign(f"`env` failed to begin the episode of seed {seed}"):
        observed, _ = env.reset(seed=seed)
    act.reset()
    total, length = 0.0, 0
    while True:
        action, length = act(observed), length + 1
        where = f"step {length} of the episode of seed {seed}"
        with foreign(f"`env` failed in {where}"):
            observed, reward, terminated, truncated, _ = env.step(action)
            gain = float(reward)
        if not np.isfinite(gain):
            raise ProblemError(f"`env` must give finite rewards; got {gain} in {where}")
        total += gain
        if terminated or truncated:
            return total, length, bool(terminated)


class Environment(gymnasium.Env):
    """A problem as an environment of Gymnasium; `environment` makes it."""

    metadata = {"render_modes": []}

    def __init__(
        self, problem: Problem, rate: float, duration: float, substeps: int | None, stop: bool
    ) -> None:
        self.problem, self._stop, space = problem, stop, problem.space
        self._plant = plant_of(lambda time, states: states, problem)
        self._inside = target_program(self._plant.target, space)
        self.period, self._samples = 1 / rate, max(1, round(duration * rate))
        self._plant.check_loop("rate", self.period, substeps)
        whole = math.floor(problem.delay * rate + SLACK)
        self._rest = max(0.0, problem.delay - whole * self.period)
        held = min(whole, self._samples) + 2
        self._queue = deque([problem.default_control], maxlen=held)  # newest last
        controls = np.vstack([problem.alphabet.values, problem.default_control])
        if substeps is None:
            substeps = choose_substeps(self._plant, controls, np.zeros((0, 1)), self.period)
        self._substeps = substeps
        self.observation_space = gymnasium.spaces.Box(space.lower, space.upper, dtype=np.float64)
        self.action_space = gymnasium.spaces.Discrete(len(problem.alphabet))
        self._reading, self._left = space.lower.copy(), 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return the observation of a new initial state, uniform in the domain.

        ``options={"state": x0}`` gives another state. Exogenous inputs are uniform in their box, or
        given by ``options={"exogenous": w}`` as numbers or a mapping of name to number.
        """
        super().reset(seed=seed)
        domain, told = self.problem.domain, self.problem.exogenous
        x, w = map((options or {}).get, ("state", "exogenous"))
        state = finite_array("state", domain.sample(1, self.np_random)[0] if x is None else x, 1)
        if state.shape != (domain.n,):
            raise ProblemError(f"`state` must have shape ({domain.n},); got {state.shape}")
        w = told.sample(1, self.np_random)[0] if told is not None and w is None else w
        self._reading, self._left = np.concatenate([state, one_exogenous(w, told)]), self._samples
        self._queue.extend([self.problem.default_control] * (self._queue.maxlen or 0))
        return self._observation(), self._info()

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold the symbol `action` over a sample.

        Returns
        -------
        observation : (n,) or (n + k,)
            The state, then exogenous inputs; see `environment`.
        reward : float
            Minus the cost of the sample, and minus the terminal cost where the episode ends. It is
            `WORST_REWARD` at least, and exactly that if the cost or the state is not finite.
        terminated, truncated : bool
            Whether the episode ended by itself, and whether its time is over.
        info : dict
            The ``state`` itself, and ``exogenous`` inputs if there are some.
        """
        if not self.action_space.contains(action):
            raise ProblemError(f"`action` must be in {self.action_space}; got {describe(action)}")
        domain = self.problem.domain
        self._queue.append(self.problem.alphabet.values[int(action)])
        x, cost, none = self._reading[:, None], np.zeros(1), np.zeros((0, 1))
        for u, time in zip(self._queue, (self._rest, self.period - self._rest)):
            if time > SLACK * self.period:
                held = (u[:, None], none, np.zeros_like(x), np.full(1, time))
                x, cost = self._plant.advance(x, cost, *held, self._substeps)
        self._reading, self._left = x[:, 0], self._left - 1
        finite = bool(np.isfinite(self._reading).all() and np.isfinite(cost[0]))
        inside = domain.contains(self._reading[None, : domain.n])[0]
        left = self.problem.outside == "error" and not inside
        arrived = self._stop and bool(self._inside.evaluate(self._reading)[0][0] == 1)
        terminated, truncated = not finite or bool(left) or arrived, self._left <= 0
        total = float(cost[0])
        if (terminated or truncated) and finite:
            total += float(self._plant.terminal_cost.evaluate(self._reading)[0][0])
        reward = max(-total, WORST_REWARD) if np.isfinite(total) else WORST_REWARD
        return self._observation(), reward, terminated, truncated, self._info()

    def _observation(self) -> np.ndarray:
        space = self.problem.space
        seen = np.nan_to_num(self._reading, posinf=np.inf, neginf=-np.inf)
        finite = np.isfinite(seen)
        seen = np.where(finite, seen, np.where(seen > 0, space.upper, space.lower))
        return np.clip(space.wrap(seen[None])[0], space.lower, space.upper)

    def _info(self) -> dict[str, Any]:
        state, exogenous = np.split(self._reading.copy(), [self.problem.domain.n])
        return {"state": state} | ({"exogenous": exogenous} if len(exogenous) else {})


def environment(
    problem: Problem,
    *,
    rate: float | None = None,
    duration: float | None = None,
    substeps: int | None = None,
    stop_at_target: bool = False,
) -> Environment:
    """Return a problem as an environment of Gymnasium.

    An action is a symbol, held over a sample. An episode begins anywhere in the domain. The
    observation is the state, brought into the period of periodic axes and to the nearest state of
    the domain; ``info`` has the state itself. Exogenous inputs follow in the observation. Exogenous
    inputs are constant in an episode, and drawn from their box, unless
    ``reset(options={"exogenous": w})`` gives them. An episode ends if the state or cost is not
    finite, or if the state leaves the domain of a problem whose `outside` is ``"error"``. A control
    acts after the problem's delay, and the default control acts before. The problem's switching is
    left to whoever acts.

    Parameters
    ----------
    problem : Problem
        The problem.
    rate : float, optional
        Samples per time unit of the problem. Default: 1 over the ``sample_time`` of its settings.
    duration : float, optional
        Time of an episode [time unit of the problem]. Default: `HORIZONS` prediction horizons.
    substeps : int, optional
        Runge-Kutta steps per sample. Default: as many as a step-doubling check asks for.
    stop_at_target : bool
        Whether an episode ends when it reaches the problem's target.

    Raises
    ------
    ProblemError
        An argument that cannot be used.
    """
    if not isinstance(problem, Problem):
        raise ProblemError(f"`problem` must be a capsyn.Problem; got {describe(problem)}")
    if substeps is not None:
        substeps = whole_number("substeps", substeps, least=1, most=1_000_000)
    own, usual = 1 / problem.settings.period, HORIZONS * (horizon_time(problem) or 0.0)
    rate = finite_number("rate", own if rate is None else rate, above=0.0)
    duration = finite_number("duration", usual if duration is None else duration, above=0.0)
    finite_number("1 / rate", 1 / rate)
    if duration * rate > MOST_SAMPLES:
        raise ProblemError(
            f"`duration` must be at most {MOST_SAMPLES:,} samples; got {duration:g} "
            f"{problem.time_unit} at {rate:g} samples per {NAMES[problem.time_unit]}"
        )
    if stop_at_target and problem.target is None:
        raise ProblemError("`stop_at_target` must be False for a problem without a target")
    return Environment(problem, rate, duration, substeps, stop_at_target)
