"""Lighting: what surfaces reflect and how it is looked up: maps, tables, fields, and primitives shaded by them."""
