"""Budgets: what a model is worth at each size."""
