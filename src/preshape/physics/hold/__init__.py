"""The holding test: a grasp is squeezed, then pushed from every side (ENGINE §4)."""
