"""Metrics: one file a metric, and the protocols that say how they are taken."""

from .perceptual import PERCEPTUAL_LOSSES, make_perceptual_loss
from .protocol import CORRECTED_METRICS, METRICS, PROTOCOLS, Protocol, get_protocol
from .vgg16 import MINIMUM_SIZE
from .weights import WeightsUnavailable, find_weights

__all__ = [
    "CORRECTED_METRICS",
    "METRICS",
    "MINIMUM_SIZE",
    "PERCEPTUAL_LOSSES",
    "PROTOCOLS",
    "Protocol",
    "WeightsUnavailable",
    "find_weights",
    "get_protocol",
    "make_perceptual_loss",
]
