"""Data sources: each makes a `Scene` from its settings."""

from .errors import DatasetError
from .registry import load_scene

__all__ = ["DatasetError", "load_scene"]
