"""The command line: ``preshape`` and ``python -m preshape``."""

from .cli import early


def main() -> None:
    """Run the command line; a signal during its imports ends it as later ones do."""
    early.install()
    import gc

    # Imports make many objects that stay: to look for cycles among them takes a twentieth of a plan's time.
    gc.set_threshold(50_000)
    from .cli.main import main as run

    run()


if __name__ == "__main__":
    main()
