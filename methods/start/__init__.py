"""Start: what a training starts from.

What the photographs say of a scene's points and normals is `evidence.py`; what they contradict is mended by
`mending.py`, where points are missing by those of `plane_sweep.py`; of points, `initialization.py` makes Gaussians.
"""
