"""Protocol: every choice between two images and their scores, under one name and one hash.

| | `envgs` | `strict` | `inria` | `nerfbaselines` |
|---|---|---|---|---|
| prediction | floats as rendered | 8 bits, rounded | 8 bits, rounded | 8 bits, truncated |
| SSIM's border | zero padding | valid interior | zero padding | valid interior |
| LPIPS-VGG's input | [0, 1] | [−1, 1] | [0, 1] | [−1, 1] |
| masked | composited on white | normalized by the mask | composited on white | composited on white |

`inria` follows the metrics.py of 3D Gaussian Splatting, which reads the PNGs that its render.py wrote; `nerfbaselines`
follows NerfBaselines' protocol "nerf" (its LPIPS of the default protocol is AlexNet's, which is not offered here).
Neither project masks, so both composite as the EnvGS paper does. FLIP is added to all.

`dists` is `envgs` with DISTS, which takes as long as LPIPS, beside it.

`color_corrected` is `envgs` with `cc_psnr`, `cc_ssim` and `cc_lpips` beside them: of pictures whose colors one affine
map a view has brought nearest to the photograph (`color_correction.py`), inside regions by the same map.

The metrics are those of `registry.py`: what is registered there, every protocol takes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

from envgs_bench.parts import MetricCard

from .metric import Choices, Metric
from .registry import corrected_metrics, registered_metrics

if TYPE_CHECKING:  # a protocol is chosen without torch, and scores with it
    from torch import Tensor

_IN_WORDS = {
    "none": "float renders, not clamped",
    "round": "renders clamped to [0, 1] and rounded to 8 bits",
    "truncate": "renders clamped to [0, 1] and truncated to 8 bits",
    "white": "masked metrics of the region composited on white",
    "normalized": "masked metrics normalized by the mask",
}


class Protocol(Choices):
    """How a prediction is scored. Numbers of protocols with different hashes do not belong in one table."""

    @property
    def metrics(self) -> dict[str, Metric]:
        """What `score` returns of a full image, by name."""
        return self.plain | self.corrected

    @property
    def plain(self) -> dict[str, Metric]:
        """Those of pictures as they are."""
        return {
            name: metric for name, metric in registered_metrics().items() if not metric.asked_for or name in self.also
        }

    @property
    def corrected(self) -> dict[str, Metric]:
        """Those of color-corrected pictures, by the names that they have there."""
        return corrected_metrics() if self.corrects_color else {}

    @property
    def cards(self) -> dict[str, MetricCard]:
        """What each of `metrics` says of itself, for the record."""
        corrected = corrected_metrics()
        return {name: replace(metric.card, corrected=name in corrected) for name, metric in self.metrics.items()}

    @property
    def hash(self) -> str:
        """Eight hexadecimal digits of every choice, the metrics' constants included; not of the name."""
        constants = {
            name: metric.constants for name, metric in registered_metrics().items() if metric.constants is not None
        }
        choices = asdict(self) | {"name": None} | constants
        if also := choices.pop("also"):  # protocols without keep their hashes, here and below
            choices |= {"also": also}
        if choices.pop("corrects_color"):
            choices |= {"color": ["affine", "least squares a view", "clamped"]}
        return hashlib.sha256(json.dumps(choices, sort_keys=True).encode()).hexdigest()[:8]

    @property
    def description(self) -> str:
        """The choices in one sentence."""
        parts = [_IN_WORDS[self.quantization], *(metric.definition(self) for metric in self.plain.values())]
        parts += [_IN_WORDS[self.masking]]
        parts += ["cc_: after one affine map of color a view, fitted to the photograph"] if self.corrects_color else []
        return "; ".join(parts)

    @property
    def not_computed(self) -> dict[str, str]:
        """Why, for every metric that cannot be had on this machine."""
        return {name: why for name, metric in self.metrics.items() if (why := metric.not_computed())}

    @property
    def weights(self) -> str | None:
        """Where the weights of LPIPS's network come from, None where LPIPS is not computed."""
        if "lpips" in self.not_computed:
            return None
        from .vgg16 import weights_source

        return weights_source()

    def of_pictures(self) -> Protocol:
        """This protocol for 8-bit pictures, which are clamped and rounded already.

        The protocol itself where it rounds too; otherwise one that does and is the same in all else, called
        <name>-8bit: its numbers are close, and its hash keeps them apart (`envgs-8bit` has that of `inria`).
        """
        return self if self.quantization == "round" else replace(self, name=f"{self.name}-8bit", quantization="round")

    def score(
        self, prediction: Tensor, target: Tensor, mask: Tensor | None = None, only: Collection[str] | None = None
    ) -> dict[str, float | None]:
        """All metrics of one image, or those of `metrics` that are named in `only`.

        Args:
            prediction: [H, W, 3] floats as rendered, sRGB, nominally in [0, 1].
            target: [H, W, 3] floats in [0, 1]: the photograph's bytes / 255.
            mask: [H, W] bool, the region to score; the full image where None. All lie on one device.

        Returns:
            The value of each of `metrics`, "psnr" in dB; with a mask also "fraction", its share of the pixels. None
            stands for a metric named in `not_computed`, and for every metric of an empty region (fraction 0).

        Raises:
            TypeError: the images are not floating-point tensors, or the mask is not boolean.
            ValueError: shapes disagree, a value is not finite, or the target lies outside [0, 1].
        """
        return self.scores(prediction, target, [mask], only)[0]

    def scores(
        self,
        prediction: Tensor,
        target: Tensor,
        masks: Sequence[Tensor | None],
        only: Collection[str] | None = None,
    ) -> list[dict[str, float | None]]:
        """`score` of one image inside each mask, None for the full image: quicker than one after the other."""
        from .scoring import scored

        return scored(self, prediction, target, masks, only)


PROTOCOLS = {
    protocol.name: protocol
    for protocol in (
        Protocol("envgs", "none", "zero", "[0, 1]", "white"),
        Protocol("strict", "round", "valid", "[-1, 1]", "normalized"),
        Protocol("inria", "round", "zero", "[0, 1]", "white"),
        Protocol("nerfbaselines", "truncate", "valid", "[-1, 1]", "white"),
        Protocol("color_corrected", "none", "zero", "[0, 1]", "white", corrects_color=True),
        Protocol("dists", "none", "zero", "[0, 1]", "white", also=("dists",)),
    )
}


def get_protocol(name: str = "envgs") -> Protocol:
    """The protocol called `name`.

    Raises:
        ValueError: no such protocol; the message lists those there are.
    """
    if name not in PROTOCOLS:
        raise ValueError(f"unknown protocol {name!r}, expected one of {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]
