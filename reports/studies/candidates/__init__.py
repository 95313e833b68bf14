"""Candidates for settings, judged by the tuning protocol."""
