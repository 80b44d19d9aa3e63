"""Fitting of contact planes: host code and Warp kernels."""
