"""Long runs that try to break preshape: damaged files, a thousand objects, killed processes."""
