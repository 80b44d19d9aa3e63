"""Hands by name or file, loaded with :func:`load_hand`.

A built-in hand is two files in ``preshape/hands/data``: ``NAME.toml`` (fingers, U, pitch, postures) and the
MJCF that it names. Reading them imports neither MuJoCo nor any other heavy library:

>>> hand = load_hand("utah_mit")
>>> hand.u, len(hand.joints), [finger.name for finger in hand.fingers]
(0.043, 16, ['thumb', 'index', 'middle', 'ring'])
>>> load_hand("shadow:left").side
'left'

Any other hand is a TOML file that names an MJCF or a URDF, which is rebuilt from simple shapes
(:mod:`preshape.hands.rewrite`). ``menagerie:NAME`` is a hand of MuJoCo Menagerie.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from ..exceptions import EnvironmentFailure, HandError, UnknownHand, shown
from ..files import MOST_OF_TOML, read_file
from ..objects.read_text import printable
from . import menagerie
from .compiled import read_model
from .couples import Table
from .description import LONGEST_MESSAGE, hand_from
from .hand import Hand
from .mirror import mirrored
from .rewrite import rebuilt

SIDES = ("right", "left")


def hand_names() -> tuple[str, ...]:
    """Names of the built-in hands, sorted."""
    folder = resources.files("preshape.hands") / "data"
    return tuple(sorted(file.name[:-5] for file in folder.iterdir() if file.name.endswith(".toml")))


def load_hand(name: str | Path, *, side: str | None = None) -> Hand:
    """Load a hand by name or from a file; its ``source`` loads the same hand again.

    Named hands are cached; a file is read at every call.

    Args:
        name: A built-in hand (:func:`hand_names`), the path of a description that ends in ``.toml``, or
            ``menagerie:NAME``. ``:left`` or ``:right`` at the end selects a side.
        side: ``right`` or ``left``; by default the side of the model. The other side is its mirror image.

    Raises:
        UnknownHand: There is no hand of that name.
        HandError: A file is missing or has a fault, or the side is neither ``right`` nor ``left``.
        EnvironmentFailure: A file cannot be read, or a model cannot be fetched.
    """
    text, wanted = _split_side(str(name), side)
    if text.lower().endswith(".toml"):
        return _from_file(Path(text), wanted)
    if text not in hand_names() and not text.startswith(menagerie.PREFIX):
        if Path(text).suffix.lower() in (".urdf", ".xml", ".mjcf"):
            raise HandError(
                f"{text} is a model; a hand is a TOML file that names its model, fingers and palm: "
                "see docs/your-own-hand.md"
            )
        raise UnknownHand(text, hand_names())
    return _by_name(text, wanted)


def source_of(name: str | Path) -> str:
    """The name, or the path of a description made absolute, so that it means the same in every folder."""
    text, side = _split_side(str(name), None)
    if text.lower().endswith(".toml"):
        text = str(Path(text).absolute())
    return text if side is None else f"{text}:{side}"


def recorded_hand(record: Mapping[str, Any]) -> Hand:
    """The hand of the ``hand`` object of a plan.json, by its ``source`` or, in older files, its ``name``.

    Raises:
        KeyError: The record has neither.
        InputError: The hand cannot be loaded; see :func:`load_hand`.
    """
    return load_hand(str(record.get("source") or record["name"]))


def parse_hand(description: str, mjcf: str) -> Hand:
    """A hand from the texts of its TOML description and of its MJCF.

    Raises:
        HandError: A field is missing or of the wrong kind, or description and MJCF contradict each other.
    """
    try:
        data = _toml(description)
    except ValueError as error:  # also a number of thousands of digits
        raise HandError(
            f"the hand's description cannot be read: {printable(error, LONGEST_MESSAGE)}"
        ) from error
    return hand_from(data, mjcf)


def read_description(path: Path) -> Table:
    """The TOML file of a hand.

    Raises:
        HandError: There is no such file, or it is not TOML.
        EnvironmentFailure: The file cannot be read.
    """
    try:
        content = read_file(path, MOST_OF_TOML, "TOML file of a hand", refusal=HandError)
        return _toml(content.decode("utf-8"))
    except FileNotFoundError as error:
        raise HandError(f"there is no file {path}") from error
    except OSError as error:
        raise EnvironmentFailure(f"{path} cannot be read: {error.strerror or error}") from error
    except ValueError as error:  # also a number of thousands of digits
        raise HandError(f"{path} is not valid TOML: {printable(error, LONGEST_MESSAGE)}") from error


def _toml(text: str) -> Table:
    """The table in a TOML text.

    Raises:
        ValueError: The text is not TOML, or is nested too deeply.
    """
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def model_file(data: Table, path: Path) -> Path:
    """Path of the model that a description names, relative to the description's own file.

    Raises:
        HandError: The description names no model, or there is no such file.
    """
    named = data.get("model", data.get("mjcf"))
    if not isinstance(named, str):
        raise HandError(f"{path}: the description lacks 'model', the MJCF or URDF of the hand")
    file = path.parent / named
    try:
        found = file.is_file()
    except OSError:  # the text cannot be a file name
        found = False
    if not found:
        raise HandError(f"{path}: there is no model {printable(file, 400)}, or it is no regular file")
    return file


def built_in_text(name: str) -> tuple[Table, str]:
    """Description and MJCF of a built-in hand.

    Raises:
        UnknownHand: There is no built-in hand of that name.
        EnvironmentFailure: Its files cannot be read.
    """
    if name not in hand_names():
        raise UnknownHand(name, hand_names())
    folder = resources.files("preshape.hands") / "data"
    try:
        data = tomllib.loads((folder / f"{name}.toml").read_text(encoding="utf-8"))
        return data, (folder / str(data.get("mjcf", f"{name}.xml"))).read_text(encoding="utf-8")
    except OSError as error:
        raise EnvironmentFailure(f"the files of hand {shown(name)} cannot be read: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise HandError(f"hand {shown(name)}: the description is not valid TOML: {error}") from error


def _from_file(path: Path, side: str | None) -> Hand:
    data = read_description(path)
    if data.get("name") in hand_names():
        raise HandError(f"{path}: a built-in hand is called {data['name']}; choose another name")
    hand = rebuilt(data, read_model(model_file(data, path)), str(path))
    return _on_side(replace(hand, source=source_of(path)), side, data)


@cache
def _by_name(name: str, side: str | None) -> Hand:
    if side is not None:
        hand = _by_name(name, None)
        return hand if side == hand.side else _on_side(hand, side, _description(name)[0])
    data, mjcf = _description(name)
    if name.startswith(menagerie.PREFIX):
        model = read_model(menagerie.fetch(name.removeprefix(menagerie.PREFIX)))
        return rebuilt(data, model, name)
    return hand_from(data, mjcf)


def _description(name: str) -> tuple[Table, str]:
    """Description of a hand that has a name, and the MJCF of the built-in hand."""
    if not name.startswith(menagerie.PREFIX):
        return built_in_text(name)
    model = name.removeprefix(menagerie.PREFIX)
    data, mjcf = built_in_text(menagerie.built_in_of(model))
    return menagerie.adapted(data, model), mjcf


def _on_side(hand: Hand, side: str | None, data: Table) -> Hand:
    """The hand, or its mirror image with joints renamed as ``left_names`` of the description says."""
    if side in (None, hand.side):
        return hand
    pair = data.get("left_names")
    rename = (str(pair[0]), str(pair[1])) if isinstance(pair, list) and len(pair) == 2 else None
    return mirrored(hand, rename=rename)


def _split_side(name: str, side: str | None) -> tuple[str, str | None]:
    for word in SIDES:
        if name.endswith(f":{word}"):
            if side not in (None, word):
                raise HandError(f"the name says {word} and the side {side}; give one of them")
            name, side = name.removesuffix(f":{word}"), word
            break
    if side not in (None, *SIDES):
        raise HandError(f"side must be right or left, got {shown(side)}")
    return name, side
