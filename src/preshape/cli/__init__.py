"""The command line: ``preshape plan mug --task pour`` and its neighbours."""
