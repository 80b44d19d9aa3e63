"""Benchmarks (`make bench`). A benchmark fails only where an answer is wrong, never because it is slow."""
