"""Accuracy against what it costs, as pictures."""
