"""What is done to preshape that nobody would do on purpose: damaged files, a thousand objects, kill -9."""
