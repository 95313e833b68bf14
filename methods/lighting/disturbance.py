"""Disturbance: what helps a base set to find reflections: color sabotage, normal propagation, resets of β (3DGS-DR)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from envgs_bench.core import Scene
from envgs_bench.parts import BASE

from ..gaussians.model import GaussianModel
from ..gaussians.parameters import inverse_sigmoid
from ..gaussians.policy import (
    INITIAL_OPACITY,
    SetPolicy,
    Start,
    base_policy,
    initial_rates,
    slowed,
)
from ..training.schedule import DISTURB_FLOOR, RESET_FLOOR, Every, Part, Schedule
from .settings import ReflectionSettings

SABOTAGE_BELOW = 0.05  # β up to which a base color is disturbed
SABOTAGE_RANGE = 0.4
PROPAGATE_ABOVE = 0.02  # β from which a primitive is enlarged
PROPAGATE_SCALE = 1.5
PROPAGATE_HOLD = 200  # steps of a run of 30,000 after a propagation in which opacities stay as they are
HOLD_FLOOR = 10  # steps

Rows = Callable[[], Tensor]  # a mask [N] of the base set


class Disturbance(Part):
    """Events of a base set with β.

    Attributes:
        is_sabotaged: whose base color sabotage disturbs: what does not reflect.
        spreads: what normal propagation enlarges: what reflects.
        may_reflect: what all of this is for; None: everything.
    """

    def __init__(self, model: GaussianModel, settings: ReflectionSettings) -> None:
        self._model, self._settings = model, settings
        self.is_sabotaged: Rows = lambda: beta_of(model) <= SABOTAGE_BELOW
        self.spreads: Rows = lambda: beta_of(model) >= PROPAGATE_ABOVE
        self.may_reflect: Rows | None = None

    def events(self) -> Sequence[Every]:
        s, events = self._settings, []
        if s.sabotage and s.disturb_every > 0:
            events.append(Every("sabotage", self.sabotage, also=self._disturbs, recovery=DISTURB_FLOOR))
        if s.propagate and s.disturb_every > 0:
            events.append(Every("propagate", self.propagate, also=self._disturbs, recovery=DISTURB_FLOOR))
        if s.rule.beta_reset_from > 0:
            events.append(Every("reset_beta", self.reset_beta, also=self._resets_beta, recovery=RESET_FLOOR))
        return events

    def sabotage(self, step: int) -> None:
        """Disturb the base color where the base does not reflect (3DGS-DR), so that a reflection may explain it."""
        parameters = self._model.sets[BASE].parameters
        dc = parameters.tensors["sh_dc"].detach()
        noise = (2 * torch.rand(dc.shape, generator=self._model.generator) - 1).to(dc) * SABOTAGE_RANGE
        disturbed = self.is_sabotaged() & self._allowed()
        parameters.replace("sh_dc", dc + noise * disturbed[:, None, None])

    def propagate(self, step: int) -> None:
        """Grow primitives that reflect over their neighbors, so that good normals spread (3DGS-DR).

        They grow along their surface, which for a 3D Gaussian lies across its shortest axis. All become nearly opaque,
        and opacities are then not trained for a while.
        """
        parameters = self._model.sets[BASE].parameters
        log_scales = parameters.tensors["log_scales"].detach()
        allowed = self._allowed()
        grows = (self.spreads() & allowed)[:, None].expand_as(log_scales)
        if self._model.axes == 3:
            grows = grows.scatter(1, log_scales.argmin(1, keepdim=True), False)
        parameters.replace("log_scales", log_scales + math.log(PROPAGATE_SCALE) * grows)
        held = round(self._model.schedule.interval(PROPAGATE_HOLD, HOLD_FLOOR))
        self._model.sets[BASE].raise_opacity(allowed, step + held)

    def reset_beta(self, step: int) -> None:
        """β to at most its start, or at least that."""
        parameters = self._model.sets[BASE].parameters
        logits = parameters.tensors["beta_logits"].detach()
        start = inverse_sigmoid(torch.full_like(logits, self._settings.initial_beta))
        bounded = torch.minimum if self._settings.rule.beta_reset == "lower" else torch.maximum
        parameters.replace("beta_logits", torch.where(self._allowed()[:, None], bounded(logits, start), logits))

    def _allowed(self) -> Tensor:
        if self.may_reflect is not None:
            return self.may_reflect()
        means = self._model.sets[BASE].parameters.tensors["means"]
        return torch.ones(len(means), dtype=torch.bool, device=means.device)

    def _disturbs(self, step: int) -> bool:
        s = self._settings
        return self._model.schedule.disturbs(
            step,
            start=s.warm_up,
            stop=s.disturb_until,
            interval=s.disturb_every,
            reset_interval=s.opacity_reset_every,
        )

    def _resets_beta(self, step: int) -> bool:
        begun = step >= self._model.schedule.at(self._settings.rule.beta_reset_from)
        return begun and self._model.policies[BASE].resets.due(step)


def reflecting_policy(s: ReflectionSettings, schedule: Schedule, scene: Scene | None) -> SetPolicy:
    """The policy of a base set with β: while reflections settle, one that grows by gradients does so more slowly."""
    start = Start(INITIAL_OPACITY, s.rule.initial_orientation, beta=s.initial_beta)
    rates = replace(initial_rates(s, schedule), beta=s.beta_lr * schedule.rate_scale)
    policy = base_policy(s, schedule, scene, start=start, rates=rates)
    if policy.fills_limit:
        return policy
    span = schedule.at(s.warm_up), schedule.at(s.disturb_until)
    return replace(policy, interval=slowed(policy.interval, s.rule.settling_interval, *span))


def beta_of(model: GaussianModel) -> Tensor:
    """β of the base set's primitives, [N] without gradients."""
    return model.sets[BASE].parameters.tensors["beta_logits"].detach()[:, 0].sigmoid()
