"""Hands of MuJoCo Menagerie, for which the package ``mujoco-menagerie`` must be installed.

That package is an index: it downloads a model when it is first used and caches it. A Menagerie model does not
say which joints form a finger, nor its closing path. Both come from the description of the built-in hand of
the same kind.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..exceptions import EnvironmentFailure, HandError, UnknownHand
from .couples import Table

PREFIX = "menagerie:"
"""Begins the name of a Menagerie hand."""

_MODELS: dict[str, tuple[str, Table]] = {
    "shadow_hand": (
        "shadow",
        {
            "licence": "Apache-2.0",
            "root": "rh_wrist",
            "palm": {"body": "rh_palm", "points": "+z", "faces": "-y"},
            "fixed": ["rh_WRJ1"],
        },
    ),
    "wonik_allegro": (
        "allegro",
        {"licence": "BSD-2-Clause", "palm": {"body": "palm", "points": "+z", "faces": "+x"}},
    ),
    "leap_hand": ("leap", {"licence": "MIT", "palm": {"body": "palm", "points": "+x", "faces": "-z"}}),
}
"""For each model, the built-in hand whose description fits, and the entries of it that are replaced."""


def built_in_of(model: str) -> str:
    """Name of the built-in hand whose description fits a Menagerie model.

    Raises:
        UnknownHand: No built-in hand fits.
    """
    if model not in _MODELS:
        raise UnknownHand(PREFIX + model, [PREFIX + known for known in _MODELS])
    return _MODELS[model][0]


def model_of(built_in: str) -> str:
    """Name of the Menagerie model of a built-in hand.

    Raises:
        HandError: There is none.
    """
    for model, (name, _) in _MODELS.items():
        if name == built_in:
            return model
    known = ", ".join(name for name, _ in _MODELS.values())
    raise HandError(f"no published model is known of the hand {built_in!r}; known for {known}")


def adapted(description: Table, model: str) -> Table:
    """The description of a built-in hand, adapted to a Menagerie model; frames are given by numbers."""
    fingers = [
        {key: x for key, x in entry.items() if key != "tip_site"}
        | {"tip_pos": entry["tip_pos"], "tip_points": entry["tip_points"]}
        for entry in description["finger"]
    ]
    texts = {
        "name": PREFIX + model,
        "title": f"{description['title']}, as in MuJoCo Menagerie",
        "source": f"MuJoCo Menagerie, {model}; its shapes as capsules, boxes, spheres and hulls",
    }
    return {**description, **texts, "finger": fingers, **_MODELS[model][1]}


def fetch(model: str) -> Path:
    """The file of a model on this machine; downloaded at its first use.

    Raises:
        EnvironmentFailure: The package is not installed, or the model cannot be downloaded.
    """
    package = _package()
    try:
        return Path(package.get(model).xml("right_hand"))
    except (package.MenagerieError, OSError) as error:
        raise EnvironmentFailure(
            f"the model {model} could not be fetched ({error}): the first use needs a network; or set "
            "MENAGERIE_ROOT to a folder that holds the models"
        ) from error


def _package() -> Any:
    try:
        import mujoco_menagerie
    except ImportError as error:
        raise EnvironmentFailure(
            "hands of MuJoCo Menagerie need the package mujoco-menagerie: pip install mujoco-menagerie"
        ) from error
    return mujoco_menagerie
