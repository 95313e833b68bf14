"""Exports: any scene as files that other programs read, and that read back as the same benchmark."""

from .exporting import FORMATS, export_scene

__all__ = ["FORMATS", "export_scene"]
