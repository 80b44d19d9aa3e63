"""Pinches at antipodal patches: host code, Warp kernels, and the NumPy twin that specifies them."""
