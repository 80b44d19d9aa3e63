"""The command line: ``preshape plan mug --task pour`` and the other commands."""
