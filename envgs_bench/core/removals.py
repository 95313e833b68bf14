"""removal_gradients(): what pictures lose with each primitive, found by the backward pass of what is drawn."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_wanted = ContextVar("removal_gradients", default=False)


@contextmanager
def removal_gradients() -> Iterator[None]:
    """What is drawn within gives its opacities another gradient: Σ over the hits of a primitive of (α·∂L/∂α)².

    A pixel's color, alpha, normal and extras are affine in each hit's alpha. So where the primitive is left out, a loss
    L that is linear in them changes by −α·∂L/∂α in that pixel, whatever lies before and behind it, also where alpha is
    clamped: ΔC = −w·(c − what is seen behind it) (GaussianPOP, Fraunhofer HHI 2026). These changes are squared pixel by
    pixel, or ray by ray, and summed. All other gradients stay what they are.
    """
    token = _wanted.set(True)
    try:
        yield
    finally:
        _wanted.reset(token)


def removals_wanted() -> bool:
    return _wanted.get()
