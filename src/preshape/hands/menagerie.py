"""Hands of MuJoCo Menagerie, through the package ``mujoco-menagerie`` where it is installed.

The package is an index that downloads a model when it is used, and keeps it. Menagerie says nothing about
fingers and closing paths: those come from the descriptions of the package's own hands of the same kind.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..exceptions import EnvironmentFailure, UnknownHand
from .compiled import read_model, rebuilt
from .description import Table
from .hand import Hand
from .load import MENAGERIE, built_in_text

_HANDS: dict[str, tuple[str, Table]] = {
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
"""For each model: the description that fits it, and what stands in its place."""


def description_of(name: str) -> Table:
    """The description for a Menagerie hand, its frames as numbers.

    Raises:
        UnknownHand: there is none for a model of that name.
    """
    if name not in _HANDS:
        raise UnknownHand(MENAGERIE + name, [MENAGERIE + known for known in _HANDS])
    own, changes = _HANDS[name]
    data, _ = built_in_text(own)
    fingers = []
    for entry in data["finger"]:
        places = {"tip_pos": entry["tip_pos"], "tip_points": entry["tip_points"]}
        fingers.append({key: x for key, x in entry.items() if key != "tip_site"} | places)
    own_words = {
        "name": MENAGERIE + name,
        "title": f"{data['title']}, as in MuJoCo Menagerie",
        "source": f"MuJoCo Menagerie, {name}; its shapes as capsules, boxes and spheres",
    }
    return {**data, **own_words, "finger": fingers, **changes}


def load_menagerie(name: str) -> Hand:
    """The hand, its model fetched by ``mujoco-menagerie``.

    Raises:
        UnknownHand: no such hand, or none that a description is known for.
        EnvironmentFailure: the package is not installed, or the model cannot be fetched.
    """
    data = description_of(name)
    return rebuilt(data, read_model(_fetch(name)), MENAGERIE + name)


def _fetch(name: str) -> Path:
    """The model's file on this machine."""
    package = _package()
    try:
        return Path(package.get(name).xml("right_hand"))
    except package.MenagerieError as error:
        raise EnvironmentFailure(
            f"the model {name} could not be fetched ({error}): a network is needed the first time, or set "
            "MENAGERIE_ROOT to a folder that holds the models"
        ) from error
    except OSError as error:
        raise EnvironmentFailure(
            f"the model {name} could not be fetched ({error}); a network is needed the first time"
        ) from error


def _package() -> Any:
    try:
        import mujoco_menagerie
    except ImportError as error:
        raise EnvironmentFailure(
            "hands of MuJoCo Menagerie need the package mujoco-menagerie: pip install mujoco-menagerie"
        ) from error
    return mujoco_menagerie
