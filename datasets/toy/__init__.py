"""Toy scenes with exact ground truth, ray traced by Embree; some with pictures path-traced by Mitsuba."""

from .settings import ToySettings
from .source import files_read, load_toy

__all__ = ["ToySettings", "files_read", "load_toy"]
