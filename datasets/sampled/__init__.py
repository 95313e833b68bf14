"""Sampled scenes: path-traced places drawn from a written distribution, with exact ground truth."""
