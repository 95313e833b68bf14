"""A trained model as files: which layouts there are, and what each can hold.

| layout | file | what it is |
|---|---|---|
| ply | <set>.ply | float32, lossless: what 3DGS and 2DGS write (`methods/storage/ply.py`) |
| compact | model.npz | ours, lossy: every set, β and the cube map, what a checkpoint holds (`compact.py`) |
| spz, sog, compressed-ply | <set>.… | lossy, for viewers: 3D Gaussians without β (`splats.py`) |

What other programs write is read by `gaussian_files.py`: PLY, SPZ (`spz_file.py`) and SOG (`sog_file.py`).
`layouts.py` lists the layouts, `quantized_set.py` and `planes.py` are what `compact.py` is made of.
"""
