"""Vector functions: each is called once, on one element, before any thread calls it.

PyTorch takes them from MKL, which chooses a function's code for this processor at its first call. Where several threads
make that call at once, one of them may run other code than the rest and be wrong in the fifth digit: about one fresh
process in twenty, so that the same seed and the same number of threads gave other numbers (pytorch/pytorch#188792).
"""

from __future__ import annotations

import torch

NAMES = (
    *("acos", "asin", "atan", "ceil", "cos", "cosh", "erf", "erfc", "erfinv", "exp", "expm1", "floor", "lgamma"),
    *("log", "log10", "log1p", "log2", "reciprocal", "round", "rsqrt", "sigmoid", "sin", "sinh", "sqrt", "tan", "tanh"),
    "trunc",
)


def call_each_once() -> None:
    """Make this process's first call of each, from one thread."""
    for dtype in (torch.float32, torch.float64):
        one = torch.full((1,), 0.5, dtype=dtype)
        for name in NAMES:
            getattr(torch, name)(one)
        torch.atan2(one, one)
        torch.pow(one, one)
