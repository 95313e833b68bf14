"""Methods: ways to learn a scene from views, all drawn by the one core.

| kind | file | what it is |
|---|---|---|
| 2dgs | two_d_gs.py | surfels, rasterized |
| 3dgs | three_d_gs.py | 3D Gaussians, rasterized |
| envmap | envmap.py | surfels with β, and a cube map for what they reflect |
| 3dgs_dr | deferred_reflection.py | 3D Gaussians with β, and a cube map for what they reflect |
| gaussian_shader | gaussian_shader.py | 3D Gaussians shaded one by one, by a filtered cube map |
| 3igs | three_igs.py | 3D Gaussians shaded one by one, by a network and a factorized illumination field |
| ref_gaussian | ref_gaussian.py | surfels with materials, and a filtered cube map for what they reflect |
| envgs | envgs.py | surfels with β, and traced environment surfels for what they reflect |
| envgs_single_set | single_set.py | surfels with β, traced for what they reflect themselves |

Each is a `GaussianMethod` (`gaussian_method.py`): sets of Gaussians trained by policies, a reflection where pixels
reflect, and parts of its own. The contract with the harness is `method.py`. Another package adds a method by an entry
point of group `envgs_bench.methods`.

| room | what is in it |
|---|---|
| gaussians/ | sets of Gaussians: fields, start, growth, pruning, what they share of a budget |
| training/ | a run's clock, what a step minimizes, its optimizer, its CUDA graphs |
| lighting/ | what surfaces reflect: maps, tables, fields |
| storage/ | a model as files |
"""
