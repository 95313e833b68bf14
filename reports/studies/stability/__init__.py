"""Stability: what perturbations did to methods."""
