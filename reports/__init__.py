"""Tables, charts, pictures and a page, from the records of runs alone."""

from .report import Report, build_report

__all__ = ["Report", "build_report"]
