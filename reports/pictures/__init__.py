"""Test views as every method drew them, side by side."""
