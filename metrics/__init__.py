"""Metrics: one file a metric, and the protocols that say how they are taken."""

from .protocol import METRICS, PROTOCOLS, Protocol, get_protocol
from .vgg16 import make_perceptual_loss
from .weights import WeightsUnavailable, find_weights

__all__ = [
    "METRICS",
    "PROTOCOLS",
    "Protocol",
    "WeightsUnavailable",
    "find_weights",
    "get_protocol",
    "make_perceptual_loss",
]
