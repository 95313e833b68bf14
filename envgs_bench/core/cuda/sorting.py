"""Stable radix sort of unsigned 32-bit keys, see radix_sort.cu."""

from __future__ import annotations

import torch
from torch import Tensor

from .launch import blocks_for, kernels, zeroed
from .layout import CONSTANTS

DIGITS, KEYS_PER_BLOCK = CONSTANTS["DIGITS"], CONSTANTS["KEYS_PER_BLOCK"]


def radix_sort(keys: Tensor, values: Tensor | None, count: Tensor, bits: int) -> tuple[Tensor, Tensor]:
    """Keys and their values in ascending order of the keys' low `bits` bits.

    Args:
        keys: [capacity] int32, read as unsigned; higher bits must be zero.
        values: [capacity] int32, or None for the keys' positions.
        count: [1] int32 on the device: how many of the keys count. What lies behind them is left undefined.
    """
    capacity, device = len(keys), keys.device
    sort = kernels(("radix_sort.cu",), device)
    passes, tiles = blocks_for(bits, 8), blocks_for(capacity, KEYS_PER_BLOCK)
    histograms, tickets, states = zeroed(device, passes * DIGITS, passes, passes * tiles * DIGITS)
    sort("radix_histograms", min(blocks_for(capacity, 1024), 1024), 256, keys, count, capacity, passes, histograms)
    buffers = [torch.empty_like(keys) for _ in range(4 if passes > 1 else 2)]
    for p in range(passes):
        out_keys, out_values = buffers[2 * (p % 2)], buffers[2 * (p % 2) + 1]
        sort("radix_pass", tiles, 256, keys, values, out_keys, out_values, count, capacity, 8 * p,
             histograms[p * DIGITS :], states[p * tiles * DIGITS :], tickets[p:])  # fmt: skip
        keys, values = out_keys, out_values
    assert values is not None
    return keys, values
