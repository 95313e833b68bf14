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
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, replace

import torch
from torch import Tensor

from envgs_bench.parts import MetricCard

from .color_correction import color_corrected
from .metric import Choices, Compared, Metric
from .registry import corrected_metrics, registered_metrics
from .vgg16 import MINIMUM_SIZE, weights_source

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
        return self._plain | (corrected_metrics() if self.corrects_color else {})

    @property
    def _plain(self) -> dict[str, Metric]:
        """Those of pictures as they are."""
        return {
            name: metric for name, metric in registered_metrics().items() if not metric.asked_for or name in self.also
        }

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
        parts = [_IN_WORDS[self.quantization], *(metric.definition(self) for metric in self._plain.values())]
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
        return None if "lpips" in self.not_computed else weights_source()

    def of_pictures(self) -> Protocol:
        """This protocol for 8-bit pictures, which are clamped and rounded already.

        The protocol itself where it rounds too; otherwise one that does and is the same in all else, called
        <name>-8bit: its numbers are close, and its hash keeps them apart (`envgs-8bit` has that of `inria`).
        """
        return self if self.quantization == "round" else replace(self, name=f"{self.name}-8bit", quantization="round")

    @torch.no_grad()
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

    @torch.no_grad()
    def scores(
        self,
        prediction: Tensor,
        target: Tensor,
        masks: Sequence[Tensor | None],
        only: Collection[str] | None = None,
    ) -> list[dict[str, float | None]]:
        """`score` of one image inside each mask, None for the full image: quicker than one after the other."""
        for mask in masks:
            _check(prediction, target, mask)
        prediction = _quantized(prediction, self.quantization)
        scored: list[dict[str, float | None]] = [dict.fromkeys(self._wanted(self.metrics, only)) for _ in masks]
        shown = [number for number, mask in enumerate(masks) if mask is None or mask.any()]
        parts = [(prediction, self._wanted(self._plain, only))]
        if corrected := self._wanted(corrected_metrics(), only) if self.corrects_color else {}:
            parts.append((color_corrected(prediction, target), corrected))
        for picture, metrics in parts if shown else []:
            regions = [self._region(picture, target, masks[number]) for number in shown]
            for name, metric in metrics.items():
                for number, value in zip(shown, metric.values(regions, self), strict=True):
                    scored[number][name] = value
        for scores, mask in zip(scored, masks, strict=True):
            if mask is not None:
                scores["fraction"] = float(mask.double().mean())
        return scored

    @staticmethod
    def _wanted(metrics: Mapping[str, Metric], only: Collection[str] | None) -> dict[str, Metric]:
        return {name: metric for name, metric in metrics.items() if only is None or name in only}

    def _region(self, prediction: Tensor, target: Tensor, mask: Tensor | None) -> Compared:
        """What metrics are taken of inside the mask, which is not empty, or of the full image."""
        if mask is None or self.masking != "white":
            return Compared(prediction, target, mask)
        inside = mask[..., None]
        return Compared(prediction.where(inside, 1.0), target.where(inside, 1.0), None)


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


def _quantized(image: Tensor, quantization: str) -> Tensor:
    """The image as a PNG would give it back. Truncation forgives the last bits of k / 255 · 255."""
    if quantization == "none":
        return image
    levels = image.clamp(0, 1) * 255 + (0.5 if quantization == "round" else 1e-3)
    return levels.floor() / 255


def _check(prediction: Tensor, target: Tensor, mask: Tensor | None) -> None:
    for name, image in (("prediction", prediction), ("target", target)):
        if not isinstance(image, Tensor) or not image.is_floating_point():
            given = image.dtype if isinstance(image, Tensor) else type(image).__name__
            raise TypeError(f"{name} is {given}, expected a floating-point tensor in [0, 1]; divide bytes by 255")
        if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < MINIMUM_SIZE:
            raise ValueError(
                f"{name} has shape {tuple(image.shape)}, expected [H, W, 3] of at least {MINIMUM_SIZE}×{MINIMUM_SIZE}"
            )
        bad = int((~image.isfinite()).sum())
        if bad:
            raise ValueError(f"{name} has {bad} values of {image.numel()} that are not finite: it cannot be scored")
    if prediction.shape != target.shape:
        raise ValueError(f"prediction is {tuple(prediction.shape)}, target {tuple(target.shape)}: sizes must agree")
    if target.min() < 0 or target.max() > 1:
        raise ValueError(f"target spans [{float(target.min()):g}, {float(target.max()):g}], expected values in [0, 1]")
    if mask is not None and mask.dtype != torch.bool:
        raise TypeError(f"mask is {mask.dtype}, expected torch.bool, True inside the region")
    if mask is not None and mask.shape != target.shape[:2]:
        raise ValueError(f"mask has shape {tuple(mask.shape)}, expected the image's {tuple(target.shape[:2])}")
