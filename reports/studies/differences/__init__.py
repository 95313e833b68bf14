"""Differences of the best method to every other."""
