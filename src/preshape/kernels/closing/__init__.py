"""Closing a hand on an object: host code, Warp kernels, and the NumPy twin that specifies them."""
