"""Thresholds of all warnings and repairs: what each is compared with, and in which unit.

They are frozen: chosen on some scenes, and counted on others by `envgs-bench diagnose`. How each was chosen and last
counted: docs/notebook/2026-11-28-warnings-counted.md and 2026-11-28-mirrored-normals-found.md.
"""

from __future__ import annotations

# Training views and points
SPARSE = 12.0  # degrees between the two nearest views of a point from which views are too few to agree on its depth
PASSES = 4  # times that each training view is learned from, below which a run is too short to judge a method by
UNSUPPORTED = 0.04  # photo-consistency of points below which they are where chance put them
MISSING = 0.5  # share of a view's textured cells with a point below which pictures show much that no point starts
TELLING = 0.7  # … from which on points say something of poses and exposures
HIDDEN = 0.25  # share of the points in a view from which its near plane hides what the view shows

# Photographs
NOISY = 0.06  # standard deviation of a pixel's noise, of the range of sRGB
BLURRED = 0.015  # the finest detail's power, as a share of that of detail three times as coarse
BLOCKY = 0.11  # how much larger steps between JPEG's blocks are than within, as a share of the mean step
UNEQUAL = 0.125  # how far the median view's linear light is off, as a logarithm
HALVES = 0.75  # how differently halves of the points say that, as a share of it: an exposure is the same for all

# Poses: shares of its differences to the points' colors that the median view loses when it is turned
POSES_OFF = 0.075  # said from here on: scenes in order have 0.062 at most, where embossing repeats itself 0.1
TURNED = 0.12  # repaired from here on: embossing that repeats itself drew views 2° off farther away at 0.08

# Normals
DISAGREEING = 22.0  # degrees between two views' normals of a point: each is then off by 15
AGREEING = 14.0  # degrees up to which normals count in full: each is then off by 10
MIRROR_PAIRS = 100  # points that a view must share with others, times these views, for its normals to be judged
MIRROR_ALIKE = 0.6  # cosine of two views' normals from which on they may be of one surface
MIRROR_GAIN = 0.005  # by how much views' normals must agree better, of 1, when some are mirrored: 0.002 in order
SEEN_THROUGH = 0.05  # share of the views' cells that must surely be: fewer may be chance, and matter little
MAYBE_SEEN_THROUGH = 0.1  # … that must be likely to
