"""Toy scenes with exact ground truth, ray traced by Embree; some with pictures path-traced by Mitsuba."""

from .settings import ToySettings
from .source import SOURCE, load_toy

__all__ = ["SOURCE", "ToySettings", "load_toy"]
