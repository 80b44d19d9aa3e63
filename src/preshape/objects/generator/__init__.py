"""The shapes behind the object library, made by our own parametric code."""
