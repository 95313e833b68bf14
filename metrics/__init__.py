"""Metrics: one file a metric, and the protocols that say how they are taken."""

from .metric import MINIMUM_SIZE, Choices, Metric
from .perceptual import PERCEPTUAL_LOSSES, make_perceptual_loss
from .protocol import PROTOCOLS, Protocol, get_protocol
from .registry import corrected_metrics, registered_metrics
from .weights import WeightsUnavailable, find_weights

__all__ = [
    "MINIMUM_SIZE",
    "PERCEPTUAL_LOSSES",
    "PROTOCOLS",
    "Choices",
    "Metric",
    "Protocol",
    "WeightsUnavailable",
    "corrected_metrics",
    "find_weights",
    "get_protocol",
    "make_perceptual_loss",
    "registered_metrics",
]
