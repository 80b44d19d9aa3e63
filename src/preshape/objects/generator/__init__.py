"""The shapes of the object library, made by parametric code of our own."""
