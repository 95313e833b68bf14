"""A benchmark of novel-view synthesis for reflective scenes, on one shared Gaussian rasterizer and ray tracer."""

from .clean_zlib import load_clean_zlib

load_clean_zlib()
