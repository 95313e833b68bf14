"""GaussianParameters: the trained form of a set of Gaussians, with an Adam group a field and rows that come and go."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from envgs_bench.core import GaussianSet

from ..training.optimizer import adam, optimizer_state, restore_optimizer
from ..training.schedule import set_rate
from .sites import sites_of

COMMON_FIELDS = frozenset({"means", "quaternions", "log_scales", "opacity_logits", "sh_dc", "sh_rest", "beta_logits"})
DEGENERATE = 1000.0  # times as long as wide, from which a primitive is degenerate
SH_DC = 0.28209479177387814  # the constant spherical harmonic, 1 / (2·√π)


@dataclass(frozen=True)
class LearningRates:
    """Adam's step sizes, one a field (EnvGS paper Sec. 5.1, values of 2DGS). The positions' is × scene radius."""

    position: float = 1.6e-4
    sh_dc: float = 2.5e-3
    sh_rest: float = 1.25e-4
    opacity: float = 5e-2
    scale: float = 5e-3
    rotation: float = 1e-3
    beta: float = 1e-2
    materials: Mapping[str, float] = field(default_factory=dict)  # of a method's own fields, by name


def primitive_bytes(axes: int, sh_degree: int, has_beta: bool) -> int:
    """Bytes of one Gaussian's parameters as float32; `axes` is 2 for surfels, 3 for 3D Gaussians."""
    position, quaternion, opacity = 3, 4, 1
    return 4 * (position + quaternion + axes + opacity + 3 * (sh_degree + 1) ** 2 + has_beta)


def material_fields(tensors: Mapping[str, Any]) -> list[str]:
    """Those of `GaussianParameters`' tensors that are a method's own, sorted."""
    return sorted(set(tensors) - COMMON_FIELDS)


class RowDraft:
    """What a set's rows are about to become. The set itself changes once, by `GaussianParameters.become`.

    Attributes:
        tensors: the fields without gradients.
        origins: [N] the row of the set that each row is, −1 for a new one.
    """

    def __init__(self, tensors: Mapping[str, Tensor]) -> None:
        self.tensors = dict(tensors)
        self.origins = torch.arange(len(tensors["means"]), device=tensors["means"].device)

    def __len__(self) -> int:
        return len(self.origins)

    def keep(self, rows: Tensor) -> None:
        """Keep only the rows that a mask [N] or an index names, in that order."""
        self.tensors = {name: value[rows] for name, value in self.tensors.items()}
        self.origins = self.origins[rows]

    def append(self, rows: Mapping[str, Tensor]) -> None:
        """Add rows behind the present ones; `rows` holds every field."""
        self.tensors = {name: torch.cat([value, rows[name].detach().to(value)]) for name, value in self.tensors.items()}
        self.origins = torch.cat([self.origins, self.origins.new_full((len(rows["means"]),), -1)])

    def rows(self, index: Tensor) -> dict[str, Tensor]:
        """Copies of the rows that a mask [N] or an index names, every field."""
        return {name: value[index].clone() for name, value in self.tensors.items()}


class GaussianParameters:
    """N Gaussians as unconstrained tensors: what Adam moves, from which `gaussians()` makes a `GaussianSet`.

    | field | shape | activation |
    |---|---|---|
    | means | [N, 3] | none |
    | quaternions | [N, 4] | none (the core normalizes) |
    | log_scales | [N, 2] or [N, 3] | exp |
    | opacity_logits | [N] | sigmoid |
    | sh_dc, sh_rest | [N, 1, 3], [N, K − 1, 3] | none |
    | beta_logits (optional) | [N, 1] | sigmoid; the set's `extras` |
    | site_colors, site_vectors (optional) | [N, 24] | none; see `sites` |
    | any other (optional) | [N, K] | its method's, which draws it: a material |

    Rows are added and removed together with Adam's moments: a row that stays keeps its own, a new row starts at zero.
    """

    def __init__(self, tensors: Mapping[str, Tensor], rates: LearningRates, radius: float) -> None:
        self.tensors = {name: value.detach().clone().requires_grad_() for name, value in tensors.items()}
        by_field = {
            "means": rates.position * radius,
            "quaternions": rates.rotation,
            "log_scales": rates.scale,
            "opacity_logits": rates.opacity,
            "sh_dc": rates.sh_dc,
            "sh_rest": rates.sh_rest,
            "beta_logits": rates.beta,
            **rates.materials,
        }
        groups = [{"params": [value], "lr": by_field[name], "name": name} for name, value in self.tensors.items()]
        self.optimizer = adam(groups)

    def __len__(self) -> int:
        return self.tensors["means"].shape[0]

    @property
    def size_bytes(self) -> int:
        """Bytes of the parameters as float32 in memory."""
        return 4 * sum(value.numel() for value in self.tensors.values())

    def gaussians(self, sh_degree: int | None = None) -> GaussianSet:
        """The activated set, differentiable; with `sh_degree` its color is cut to that many SH bands."""
        return activated(self.tensors, sh_degree)

    def degenerate(self) -> Tensor:
        """The share of the primitives that are DEGENERATE times as long as wide and more, by their two longest axes."""
        longest, second = self.tensors["log_scales"].detach().topk(2, dim=1).values.unbind(dim=1)
        return (longest - second > math.log(DEGENERATE)).float().mean()

    def set_learning_rate(self, name: str, rate: float) -> None:
        set_rate(self._group(name), rate)

    def replace(self, name: str, values: Tensor) -> None:
        """Overwrite one field, same shape, and forget its moments."""
        old = self.tensors[name]
        state = self.optimizer.state.get(old, {})
        for moment in ("exp_avg", "exp_avg_sq"):
            if moment in state:
                state[moment].zero_()
        with torch.no_grad():
            old.copy_(values)

    def restart(self, name: str) -> None:
        """Let Adam forget one field: its moments, and how many steps they were made of."""
        for remembered in self.optimizer.state.get(self.tensors[name], {}).values():
            remembered.zero_()

    def draft(self) -> RowDraft:
        """The present rows, for whoever is to change which there are."""
        return RowDraft(self.detached())

    def become(self, draft: RowDraft) -> None:
        """Take the draft's rows, all fields at once."""

        def carried(moment: Tensor) -> Tensor:
            zero = moment.new_zeros(1, *moment.shape[1:])  # the last row, which is the one that −1 names
            return torch.cat([moment, zero])[draft.origins]

        for name in list(self.tensors):
            self._swap(name, draft.tensors[name], carried)

    def detached(self) -> dict[str, Tensor]:
        """The present values without gradients, not copied."""
        return {name: value.detach() for name, value in self.tensors.items()}

    def training_state(self) -> dict[str, Any]:
        """The fields and Adam's moments, by field: what `restore_training` becomes."""
        return {"tensors": self.detached(), "moments": optimizer_state(self.optimizer, self.tensors)}

    def restore_training(self, state: Mapping[str, Any]) -> None:
        """Become what `training_state` returned, whatever number of rows that has."""
        for name, old in list(self.tensors.items()):
            self._swap(name, state["tensors"][name].to(old.detach()), lambda moment: moment)
        restore_optimizer(self.optimizer, self.tensors, state["moments"])

    def _group(self, name: str) -> dict:
        return next(group for group in self.optimizer.param_groups if group["name"] == name)

    def _swap(self, name: str, values: Tensor, carry) -> None:
        """Put `values` in the field's place, with Adam's moments passed through `carry`."""
        old, new = self.tensors[name], values.contiguous().requires_grad_()
        state = self.optimizer.state.pop(old, None)
        if state:
            moments = {key: carry(state[key]).contiguous() for key in ("exp_avg", "exp_avg_sq")}
            self.optimizer.state[new] = {"step": state["step"], **moments}
        self._group(name)["params"] = [new]
        self.tensors[name] = new


def activated(tensors: Mapping[str, Tensor], sh_degree: int | None = None) -> GaussianSet:
    """The set of `GaussianParameters`' tensors, differentiable; with `sh_degree` of SH cut to that many bands."""
    if "site_vectors" in tensors:
        sh = sites_of(tensors, 0.5 + SH_DC * tensors["sh_dc"])
    else:
        sh = torch.cat([tensors["sh_dc"], tensors["sh_rest"]], dim=1)
        if sh_degree is not None:
            sh = sh[:, : (sh_degree + 1) ** 2]
    return GaussianSet(
        means=tensors["means"],
        quaternions=tensors["quaternions"],
        scales=tensors["log_scales"].exp(),
        opacities=tensors["opacity_logits"].sigmoid(),
        sh=sh,
        extras=tensors["beta_logits"].sigmoid() if "beta_logits" in tensors else None,
    )


def inverse_sigmoid(values: Tensor) -> Tensor:
    """log(p / (1 − p)), with p clamped to [1e-6, 1 − 1e-6]."""
    return torch.logit(values, eps=1e-6)


def sh_from_rgb(rgb: Tensor, degree: int) -> tuple[Tensor, Tensor]:
    """SH that shows `rgb` [N, 3] from every direction: the constant [N, 1, 3] and zeros [N, (degree+1)² − 1, 3]."""
    dc = ((rgb - 0.5) / SH_DC)[:, None]
    return dc, dc.new_zeros(len(rgb), (degree + 1) ** 2 - 1, 3)
