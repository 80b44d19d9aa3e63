"""Benchmarks: `make bench`. A benchmark fails when the answer is wrong, never because a machine is slow."""
