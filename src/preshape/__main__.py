"""``python -m preshape``."""

from .cli.main import main

main()
