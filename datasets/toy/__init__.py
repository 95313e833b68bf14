"""Toy scenes with exact ground truth, ray traced by Embree."""

from .source import ToySettings, load_toy

__all__ = ["ToySettings", "load_toy"]
