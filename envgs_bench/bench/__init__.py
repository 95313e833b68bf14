"""Benchmarks of the core itself."""
