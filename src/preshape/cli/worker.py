"""A planner process of ``preshape serve``: plans for HTTP, and commands for this user's command line."""

from __future__ import annotations

import sys
from typing import Any

from ..serve.worker import Say, WarmPlanner, serve


def main(arguments: list[str]) -> None:
    """Serve until standard input ends.

    Args:
        arguments: The memory's file, or nothing for the user's, and the hands to warm up for.
    """
    memory, *hands = arguments
    planner = WarmPlanner(memory or None)

    def answer(message: dict[str, Any], say: Say) -> None:
        say({"text": planner.plan(message["request"], message["names"]), "done": True})

    serve(answer, lambda: planner.warm(hands))


if __name__ == "__main__":
    main(sys.argv[1:])
