"""Diagnosis: what is wrong with a scene's points, poses, photographs and normals, told by the photographs alone.

A run's scene is looked at once, before its method starts (`diagnosis.py`), whichever the method: for warnings
(`scene_warnings.py`), for the repairs that the run asks for (`repair.py`), and for methods that learn from estimated
normals (`agreed_normals.py`). Thresholds are those of `thresholds.py`.
"""
