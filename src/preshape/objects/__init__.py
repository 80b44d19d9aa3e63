"""Objects: meshes, readers, and the built-in library (environment sensing element, §3.2)."""
