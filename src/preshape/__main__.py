"""The command line: ``preshape`` and ``python -m preshape``."""

from .cli import early


def main() -> None:
    """Run the command line; a signal during its imports ends it as later ones do."""
    early.install()
    from .cli.main import main as run

    run()


if __name__ == "__main__":
    main()
