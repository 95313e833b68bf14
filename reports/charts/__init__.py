"""Accuracy against what it costs, as pictures, and how training got there, as curves."""
