"""A hand's description as the text of a TOML file, commented as those of the built-in hands are."""

from __future__ import annotations

import json
import re
from typing import Any

from .couples import Table

_COMMENTS = {
    "model": "beside this file; URDF or MJCF",
    "root": "the hand's mount: what carries it is left out",
    "u": "U [m]: length of the middle finger's proximal phalanx",
    "finger_pitch": "distance between neighbouring fingers [m]",
    "points": "direction in which the open fingers point, in this body's frame",
    "faces": "direction that the palm faces; the thumb is on that side",
    "gain": "N m/rad",
    "damping": "N m s/rad",
    "torque_limit": "N m",
    "tip_pos": "centre of the fingertip in the frame of tip_body [m]",
    "tip_points": "direction of the last phalanx, outwards",
    "ignore": "pairs of links whose overlap does not count",
    "fixed": "joints that belong to no finger, and their angles [rad]",
}


def toml_text(data: Table, lines: tuple[str, ...] = ()) -> str:
    """The TOML text of a description; reading it gives the same table.

    Args:
        data: The description, as read from TOML.
        lines: Comments for its head.
    """
    plain = {
        key: entry for key, entry in data.items() if key not in ("palm", "actuators", "finger", "couple")
    }
    written = [f"# {line}" for line in lines]
    written += ["# Units: m, rad, N m. What is wrong here is corrected here: docs/your-own-hand.md.", ""]
    written += _entries(plain)
    for key, head in (("palm", ""), ("actuators", "Position servos of the motors.")):
        if key in data:
            written += ["", *([f"# {head}"] if head else []), f"[{key}]", *_entries(data[key])]
    for couple in data.get("couple", []):
        written += ["", "[[couple]]", *_entries(couple)]
    written += [
        "",
        "# The thumb comes first, then the other fingers from the index side.",
        "# closing: joint angles from open to closed, linear in between.",
        "# preshape: range of each joint that a preshape may set before the finger closes.",
    ]
    for finger in data.get("finger", []):
        written += ["", "[[finger]]", *_entries(finger)]
    return "\n".join(written) + "\n"


def _entries(table: Table) -> list[str]:
    return [
        f"{_key(key)} = {_value(entry)}" + (f"  # {_COMMENTS[key]}" if key in _COMMENTS else "")
        for key, entry in table.items()
    ]


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _text(key)


def _text(text: str) -> str:
    # A TOML basic string is a JSON string, except that it also forbids the character DEL.
    return json.dumps(text, ensure_ascii=True).replace("\x7f", "\\u007f")


def _value(entry: Any) -> str:
    if isinstance(entry, bool):
        return "true" if entry else "false"
    if isinstance(entry, str):
        return _text(entry)
    if isinstance(entry, (list, tuple)):
        return "[" + ", ".join(_value(item) for item in entry) + "]"
    if isinstance(entry, dict):
        return "{ " + ", ".join(f"{_key(key)} = {_value(item)}" for key, item in entry.items()) + " }"
    return repr(entry)
