"""Growth by MCMC (Kheradmand et al. 2024): the dead move to the living, sets fill their limit, positions drift.

A primitive is drawn from with its opacity as probability, and shares what it shows with its copies: the equations are
those of *3D Gaussian Splatting as Markov Chain Monte Carlo*, NeurIPS 2024. There gradients decide nothing. Guided
growth draws by them too, so that copies go where the picture is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor

from envgs_bench.core.torch.rotation import rotation_matrices

from ..training.schedule import Part
from .densification import DensificationRecord, drawn_offsets
from .parameters import GaussianParameters, RowDraft, inverse_sigmoid

DEAD = 0.005  # opacity up to which a primitive is moved
GROWTH = 1.05  # × the set that one growth leaves at most
MOST_SHARES = 51  # in which one primitive is divided at once
NOISE = 5e5  # × the positions' rate, of the noise along a primitive's own covariance
EXCHANGED = 0.05  # share of the set, of what weighs least, that guided growth moves too
GATE = 100.0  # how sharply the noise ends with opacity: sigmoid(GATE·(DEAD − opacity))


def shared(opacities: Tensor, scales: Tensor, shares: Tensor) -> tuple[Tensor, Tensor]:
    """Opacities [K] and scales [K, A] of each of `shares` [K] equal parts that look together like the whole (Eq. 9).

    1 − (1 − o')ⁿ = o in the middle; and along any line through it, the integral of what n parts stop is what one did.
    """
    n, o = shares[:, None].double(), opacities[:, None].double()
    part = 1 - (1 - o) ** (1 / n)
    k = torch.arange(1, MOST_SHARES + 1, device=o.device, dtype=torch.float64)
    log_binomial = torch.lgamma(n + 1) - torch.lgamma(k + 1) - torch.lgamma((n - k).clamp_min(0) + 1)
    terms = (-1) ** (k - 1) * (log_binomial + k * part.log()).exp() / k.sqrt()
    integral = torch.where(k <= n, terms, 0).sum(1, keepdim=True)
    return part[:, 0].to(opacities), (scales.double() * o / integral).to(scales)


class Sharing(NamedTuple):
    """In what a primitive and its copies differ from equal parts in one place.

    Attributes:
        smaller: what their scales are divided by.
        apart: × an offset drawn from its own Gaussian, by which a copy starts apart.
    """

    smaller: float = 1.0
    apart: float = 0.0


IN_ONE_PLACE = Sharing()
PARTED = Sharing(smaller=1.3, apart=0.7)


def relocate(
    parameters: GaussianParameters, most: int, generator: torch.Generator, guide: DensificationRecord | None = None
) -> DensificationRecord:
    """Move what is dead to where live primitives are, then grow by a twentieth, up to `most`; the new, empty record.

    What was moved, and what it shares with, starts Adam's moments anew. A set that is larger than `most` loses its most
    transparent primitives.

    Args:
        guide: what the last steps found of the set, where that decides too: a primitive is drawn by its opacity × mean
            gradient then, what they saw and weighs least moves too, and what shares is parted.
    """
    draft = parameters.draft()
    kept = _cut(draft, most)
    opacities = draft.tensors["opacity_logits"].sigmoid()
    moved, pull, sharing = opacities <= DEAD, torch.ones_like(opacities), IN_ONE_PLACE
    if guide is not None:
        guide.keep(kept)
        moved, sharing = moved | _least_weighted(guide), PARTED
        if bool((~moved & (guide.gradients > 0)).any()):
            pull = guide.mean_gradient()
    _move_and_grow(draft, moved, pull, most, generator, sharing)
    parameters.become(draft)
    return DensificationRecord(len(parameters), opacities.device)


class PositionNoise(Part):
    """Noise on a set's positions after every step that counts: along each primitive's covariance, if it is transparent.

    It is drawn before the step, so that a CUDA graph finds it in place.
    """

    def __init__(self, device: torch.device, seed: int) -> None:
        self._generator = torch.Generator(device).manual_seed(seed)
        self._drawn = torch.zeros(0, 3, device=device)

    def draw(self, count: int, rate: float) -> None:
        """The noise of a step for `count` primitives; `rate` is the positions' learning rate, world units."""
        if len(self._drawn) != count:
            self._drawn = self._drawn.new_empty(count, 3)
        self._drawn.normal_(generator=self._generator).mul_(NOISE * rate)

    @torch.no_grad()
    def move(self, tensors: Mapping[str, Tensor], counts: Tensor) -> None:
        """Move `GaussianParameters`' means by the noise, where `counts`, a truth on the device."""
        axes = rotation_matrices(tensors["quaternions"])[..., : tensors["log_scales"].shape[1]]
        along = torch.einsum("nij,ni->nj", axes, self._drawn) * (2 * tensors["log_scales"]).exp()
        gate = (GATE * (DEAD - tensors["opacity_logits"].sigmoid())).sigmoid()
        tensors["means"] += torch.where(counts, gate[:, None] * torch.einsum("nij,nj->ni", axes, along), 0.0)

    def training_state(self) -> dict[str, Any]:
        return {"generator": self._generator.get_state()}

    def restore_training(self, state: Mapping[str, Any]) -> None:
        self._generator.set_state(state["generator"])


def _cut(draft: RowDraft, most: int) -> Tensor:
    """Leave at most that many rows, the most opaque ones; those that are left, in order."""
    kept = draft.tensors["opacity_logits"].topk(min(most, len(draft))).indices.sort().values
    if len(kept) < len(draft):
        draft.keep(kept)
    return kept


def _move_and_grow(
    draft: RowDraft, moved: Tensor, pull: Tensor, most: int, generator: torch.Generator, sharing: Sharing
) -> None:
    """Make of the rows in the mask `moved` copies of others, then more copies; both drawn by opacity × pull [N] ≥ 0."""
    if not len(draft) or bool(moved.all()):
        return
    rows = torch.nonzero(moved)[:, 0]
    chances = torch.where(moved, 0, draft.tensors["opacity_logits"].sigmoid() * pull)
    copies, sources = _copies(draft, chances, len(rows), generator, sharing)
    draft.tensors = {name: values.index_copy(0, rows, copies[name]) for name, values in draft.tensors.items()}
    draft.origins[rows] = -1
    pull = pull.index_copy(0, rows, pull[sources])
    new = min(most, math.ceil(GROWTH * len(draft))) - len(draft)
    chances = draft.tensors["opacity_logits"].sigmoid() * pull
    draft.append(_copies(draft, chances, new, generator, sharing)[0])


def _least_weighted(guide: DensificationRecord) -> Tensor:
    """A mask [N] of the twentieth that weighs least, of those that any step drew."""
    weights = torch.where(guide.steps > 0, guide.mean_weight(), torch.inf)
    least = torch.topk(weights, math.ceil(EXCHANGED * len(weights)), largest=False)
    return torch.zeros_like(weights, dtype=torch.bool).index_fill(0, least.indices[least.values < torch.inf], True)


def _copies(
    draft: RowDraft, chances: Tensor, count: int, generator: torch.Generator, sharing: Sharing
) -> tuple[dict[str, Tensor], Tensor]:
    """Fields of `count` copies of rows drawn by their chances [N], and the rows [count], which are divided for them."""
    sources = _drawn(chances, count, generator)
    _divide(draft, sources, sharing.smaller)
    copies = draft.rows(sources)
    if sharing.apart:
        copies["means"] += sharing.apart * drawn_offsets(copies, generator)
    return copies, sources


def _drawn(chances: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """`count` rows, drawn by their chances [N] ≥ 0 of any sum, with replacement."""
    if not count:
        return torch.zeros(0, dtype=torch.long, device=chances.device)
    total = chances.double().cumsum(0).cpu()
    places = torch.rand(count, generator=generator, dtype=torch.float64) * total[-1]
    rows = torch.searchsorted(total, places, right=True).clamp_max(len(total) - 1)
    return rows.to(chances.device)


def _divide(draft: RowDraft, sources: Tensor, smaller: float) -> None:
    """Let each of the rows `sources` be one of as many parts as it is named, and one, of scales ÷ `smaller`."""
    shares = (torch.bincount(sources, minlength=len(draft)) + 1).clamp_max(MOST_SHARES)
    rows = torch.nonzero(shares > 1)[:, 0]
    tensors = draft.tensors
    opacities, scales = shared(
        tensors["opacity_logits"][rows].sigmoid(), tensors["log_scales"][rows].exp(), shares[rows]
    )
    logits = inverse_sigmoid(opacities.clamp_min(DEAD))
    draft.tensors = tensors | {
        "opacity_logits": tensors["opacity_logits"].index_copy(0, rows, logits),
        "log_scales": tensors["log_scales"].index_copy(0, rows, (scales / smaller).log()),
    }
    draft.origins[rows] = -1
