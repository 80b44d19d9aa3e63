"""Fast kernels, each with a plain NumPy twin."""
