"""The holding test: the hand squeezes the object, which is then pushed from every side (ENGINE §4)."""
