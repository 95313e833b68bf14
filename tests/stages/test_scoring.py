"""Where pictures are scored."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from envgs_bench.metrics import Protocol, get_protocol
from envgs_bench.stages.scoring import Pair, score_pairs

PICTURES = torch.rand(2, 16, 20, 3, generator=torch.Generator().manual_seed(0))
LEFT = torch.arange(20).expand(16, 20) < 8


class Crowded(Protocol):
    """A protocol for which no device but the CPU has room."""

    def scores(
        self,
        prediction: Tensor,
        target: Tensor,
        masks: Sequence[Tensor | None],
        only: Collection[str] | None = None,
    ) -> list[dict[str, float | None]]:
        if prediction.is_meta or target.is_meta or any(mask is not None and mask.is_meta for mask in masks):
            raise torch.OutOfMemoryError("no room")
        return super().scores(prediction, target, masks, only)


def test_what_a_device_has_no_room_for_is_scored_on_the_cpu() -> None:
    pair = Pair("0000", *PICTURES, {"left": LEFT, "none": torch.zeros_like(LEFT)})
    protocol = get_protocol("envgs")
    crowded = Crowded(**vars(protocol))
    assert score_pairs([pair], crowded, "meta") == score_pairs([pair], protocol)


def test_pictures_are_scored_on_the_device() -> None:
    devices: list[str] = []

    class Recording(Protocol):
        def scores(
            self,
            prediction: Tensor,
            target: Tensor,
            masks: Sequence[Tensor | None],
            only: Collection[str] | None = None,
        ) -> list[dict[str, float | None]]:
            devices.extend(image.device.type for image in (prediction, target, *masks) if image is not None)
            return [{"psnr": 1.0}, {"psnr": 1.0, "fraction": 0.4}]

    recording = replace(Recording(**vars(get_protocol("envgs"))), name="recording")
    score_pairs([Pair("0000", *PICTURES, {"left": LEFT})], recording, "meta")
    assert devices == ["meta"] * 3
