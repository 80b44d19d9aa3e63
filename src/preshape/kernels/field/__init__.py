"""Signed distance fields: host code, Warp kernels, and the NumPy twin that specifies them."""
