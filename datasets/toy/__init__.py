"""Toy scenes with exact ground truth, ray traced by Embree; some with pictures path-traced by Mitsuba."""
