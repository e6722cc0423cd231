"""What a controller is made of: model, alphabet, default control, horizon, settings."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from capsyn.modelling.domain import Box
from capsyn.modelling.settings import SsacSettings
from capsyn.modelling.switching import Switching
from capsyn.policies.policy import Policy
from capsyn.programs.model import Model

if TYPE_CHECKING:
    from capsyn.modelling.problem import Problem  # brings CasADi, which policies do without


@dataclass(frozen=True, eq=False)
class Formulation:
    """What a controller is made of, be it from a problem, a policy or another process."""

    model: Model  # the system and its costs, as programs
    domain: Box  # its states, and exogenous inputs after them
    values: np.ndarray  # (N, m): the symbols' control vectors [input units]
    default: np.ndarray  # (m,): control of the prediction [input units]
    horizon: float  # of the prediction, T [time unit]
    settings: SsacSettings
    prices: np.ndarray | None = None  # (N + 1, N + 1) of `SwitchRules`; None: nothing is in force
    delay: float = 0.0  # input delay that is compensated [time unit]

    @staticmethod
    def of(
        source: Problem | Policy, model: Model, switching: Switching | None = None
    ) -> Formulation:
        """Return that of a problem or a policy, which has horizon and settings, and its model.

        `switching` is its own, by default, unless that has shares: then nothing is in force yet.
        """
        assert source.horizon is not None and source.settings is not None
        values, default = source.alphabet.values, source.default_control
        switching, prices = switching or source.switching, None
        if switching is not None and not switching.has_share:
            prices = switching.prices(source.alphabet, default)
        elif switching is None and source.delay:
            prices = np.zeros((len(values) + 1,) * 2)
        return Formulation(
            model, source.space, values, default, source.horizon, source.settings, prices,
            source.delay,
        )  # fmt: skip

    def to_text(self) -> str:
        """Return the formulation as JSON, with the programs as a policy's file holds them."""
        plain = {
            "model": self.model.to_json(),
            "domain": self.domain.to_json(),
            "values": self.values.tolist(),
            "default": self.default.tolist(),
            "horizon": self.horizon,
            "settings": self.settings.to_json(),
            "prices": None if self.prices is None else self.prices.tolist(),
            "delay": self.delay,
        }
        return json.dumps(plain, sort_keys=True)

    @staticmethod
    def from_text(text: str) -> Formulation:
        """Return the formulation in a `to_text`."""
        data = json.loads(text)
        domain, values = Box(**data["domain"]), np.array(data["values"])
        return Formulation(
            Model.from_json(data["model"], domain.n, values.shape[1], len(values)),
            domain,
            values,
            np.array(data["default"]),
            data["horizon"],
            SsacSettings(**data["settings"]),
            None if data["prices"] is None else np.array(data["prices"]),
            data["delay"],
        )
