"""Objects: meshes from files, point clouds and the built-in library (§2.1)."""
