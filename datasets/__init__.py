"""Data sources: each makes a `Scene` from its settings."""

from .registry import load_scene
from .settings import DatasetError

__all__ = ["DatasetError", "load_scene"]
