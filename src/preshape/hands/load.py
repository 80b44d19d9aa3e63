"""Hands by name or file: what the planner needs to know of each, beside its MJCF.

A hand of the package is two files in ``preshape/hands/data``: ``NAME.toml`` (fingers, U, pitch, postures) and
the MJCF it names. Reading them imports neither MuJoCo nor any other heavy library:

>>> hand = load_hand("utah_mit")
>>> hand.u, len(hand.joints), [finger.name for finger in hand.fingers]
(0.043, 16, ['thumb', 'index', 'middle', 'ring'])
>>> load_hand("shadow:left").side
'left'

Any other hand is a TOML of its own that names an MJCF or a URDF (:mod:`preshape.hands.compiled`).
"""

from __future__ import annotations

import tomllib
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from ..exceptions import EnvironmentFailure, HandError, InputError, UnknownHand
from ..objects.read_text import shown
from .description import build_hand
from .hand import Finger, Hand
from .mirror import mirrored

__all__ = ["Finger", "Hand", "hand_names", "load_hand", "parse_hand", "read_description"]

SIDES = ("right", "left")
MENAGERIE = "menagerie:"
_LONGEST = 1200  # characters of a message; names in a file can be of any length


def hand_names() -> tuple[str, ...]:
    """Names of the hands that come with the package, sorted."""
    folder = resources.files("preshape.hands") / "data"
    return tuple(sorted(file.name[:-5] for file in folder.iterdir() if file.name.endswith(".toml")))


def load_hand(name: str | Path, *, side: str | None = None) -> Hand:
    """The hand of a name or a file; of a name the same value at every call.

    Args:
        name: a built-in hand (:func:`hand_names`); a path that ends in ``.toml``; or ``menagerie:NAME``, by
            the package ``mujoco-menagerie``. ``:left`` or ``:right`` at the end asks for a side.
        side: the side wanted, ``right`` or ``left``; default the hand's own. The other is its mirror image.

    Raises:
        UnknownHand: no hand of that name.
        HandError: its files contradict each other, or ask for what there is not.
        EnvironmentFailure: its files cannot be read, or a model cannot be fetched.
    """
    text, asked = _split_side(str(name), side)
    if text.startswith(MENAGERIE):
        return _sided(_menagerie(text), asked, _rename(text))
    if text.lower().endswith(".toml"):
        from .compiled import load_foreign

        path = Path(text)
        return _sided(load_foreign(path), asked, _rename_in(read_description(path)))
    if text not in hand_names():
        if Path(text).suffix.lower() in (".urdf", ".xml", ".mjcf"):
            raise HandError(
                f"{text} is a model; a hand is a TOML file that names its model, fingers and palm: "
                "see docs/your-own-hand.md"
            )
        raise UnknownHand(text, hand_names())
    return _built_in(text, asked)


def parse_hand(description: str, mjcf: str) -> Hand:
    """A hand from the text of its TOML description and of its MJCF.

    Raises:
        HandError: a field is missing or of the wrong kind, or description and MJCF contradict each other.
    """
    try:
        data = tomllib.loads(description)
    except (ValueError, RecursionError) as error:  # ValueError: also a number of thousands of digits
        raise HandError(f"the hand's description cannot be read: {shown(error, _LONGEST)}") from error
    return hand_from(data, mjcf)


def hand_from(data: dict[str, Any], mjcf: str, *, name: str | None = None) -> Hand:
    """As :func:`parse_hand`, from a description that was read; ``name`` replaces the description's."""
    called = name or data.get("name", "?")
    try:
        return build_hand(data, ElementTree.fromstring(mjcf), mjcf, name=name)
    except ElementTree.ParseError as error:
        raise HandError(f"the hand's MJCF cannot be read: {error}") from error
    except KeyError as error:
        raise HandError(shown(f"hand {called!r}: the description lacks {error}", _LONGEST)) from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise HandError(shown(f"hand {called!r}: {error}", _LONGEST)) from error
    except InputError as error:
        raise HandError(shown(error, _LONGEST)) from error


def read_description(path: Path) -> dict[str, Any]:
    """The TOML file of a hand.

    Raises:
        HandError: there is no such file, or it is not TOML.
        EnvironmentFailure: it cannot be read.
    """
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8"))
    except FileNotFoundError as error:
        raise HandError(f"there is no file {path}") from error
    except IsADirectoryError as error:
        raise HandError(f"{path} is a folder; a hand is a TOML file") from error
    except OSError as error:
        raise EnvironmentFailure(f"{path} cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:  # ValueError: also a number of thousands of digits
        raise HandError(f"{path} is not valid TOML: {shown(error, _LONGEST)}") from error


def built_in_text(name: str) -> tuple[dict[str, Any], str]:
    """Description and MJCF of a hand of the package.

    Raises:
        UnknownHand: no hand of that name.
        EnvironmentFailure: its files cannot be read.
    """
    if name not in hand_names():
        raise UnknownHand(name, hand_names())
    folder = resources.files("preshape.hands") / "data"
    try:
        data = tomllib.loads((folder / f"{name}.toml").read_text(encoding="utf-8"))
        return data, (folder / str(data.get("mjcf", f"{name}.xml"))).read_text(encoding="utf-8")
    except OSError as error:
        raise EnvironmentFailure(f"the files of hand {name!r} cannot be read: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise HandError(f"hand {name!r}: the description is not valid TOML: {error}") from error


@cache
def _built_in(name: str, side: str | None) -> Hand:
    data, mjcf = built_in_text(name)
    hand = hand_from(data, mjcf)
    if side in (None, hand.side):
        return hand if side is None else _built_in(name, None)
    return mirrored(hand, rename=_rename_in(data))


@cache
def _menagerie(name: str) -> Hand:
    from .menagerie import load_menagerie

    return load_menagerie(name.removeprefix(MENAGERIE))


def _split_side(name: str, side: str | None) -> tuple[str, str | None]:
    for word in SIDES:
        if name.endswith(f":{word}"):
            if side not in (None, word):
                raise HandError(f"the name says {word} and the side {side}; give one of them")
            name, side = name.removesuffix(f":{word}"), word
            break
    if side not in (None, *SIDES):
        raise HandError(f"side must be right or left, got {side!r}")
    return name, side


def _sided(hand: Hand, side: str | None, rename: tuple[str, str] | None) -> Hand:
    return hand if side in (None, hand.side) else mirrored(hand, rename=rename)


def _rename(name: str) -> tuple[str, str] | None:
    from .menagerie import description_of

    return _rename_in(description_of(name.removeprefix(MENAGERIE)))


def _rename_in(data: dict[str, Any]) -> tuple[str, str] | None:
    pair = data.get("left_names")
    return (str(pair[0]), str(pair[1])) if isinstance(pair, list) and len(pair) == 2 else None
