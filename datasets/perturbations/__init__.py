"""What can be wrong with a scene's data: photographs, poses, points, normals, background and masks."""
