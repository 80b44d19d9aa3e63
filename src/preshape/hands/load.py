"""Hands by name or file, loaded with :func:`load_hand`.

A built-in hand is two files in ``preshape/hands/data``: ``NAME.toml`` (fingers, U, pitch, postures) and the
MJCF that it names. Reading them imports neither MuJoCo nor any other heavy library:

>>> hand = load_hand("utah_mit")
>>> hand.u, len(hand.joints), [finger.name for finger in hand.fingers]
(0.043, 16, ['thumb', 'index', 'middle', 'ring'])
>>> load_hand("shadow:left").side
'left'

Any other hand is an MJCF or a URDF, whose fingers and palm are inferred (:mod:`preshape.hands.init`), or a
TOML file that names one and states them; either way the model is rebuilt (:mod:`preshape.hands.rewrite`).
``menagerie:NAME`` is a hand of MuJoCo Menagerie.
"""

from __future__ import annotations

import hashlib
import logging
import os
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._version import __version__
from ..exceptions import EnvironmentFailure, HandError, UnknownHand, shown
from ..files import (
    MOST_OF_JSON,
    MOST_OF_TOML,
    cache_folder,
    loads,
    make_folder,
    read_file,
    write_json,
    write_text,
)
from ..objects.read_text import printable
from . import menagerie
from .couples import Table
from .description import LONGEST_MESSAGE, hand_from
from .hand import Hand
from .mirror import mirrored
from .toml_text import toml_text

if TYPE_CHECKING:
    from .compiled import CompiledModel
    from .init import Guess

SIDES = ("right", "left")

MODELS = (".urdf", ".xml", ".mjcf", ".xacro")
"""What the name of a model ends in."""

MOTORS = "#motors="
"""What joins a model, or a description, and the file of its motors in the source of a hand."""

_log = logging.getLogger("preshape.hands")
_said: set[str] = set()
"""Models whose guesses this process has said."""


def hand_names() -> tuple[str, ...]:
    """Names of the built-in hands, sorted."""
    folder = resources.files("preshape.hands") / "data"
    return tuple(sorted(file.name[:-5] for file in folder.iterdir() if file.name.endswith(".toml")))


def load_hand(name: str | Path, *, side: str | None = None) -> Hand:
    """Load a hand by name or from a file; its ``source`` loads the same hand again.

    Named hands are cached; a file is read at every call.

    Args:
        name: A built-in hand (:func:`hand_names`), the path of a description that ends in ``.toml``, that
            of a model (``.urdf``, ``.xml``, ``.mjcf``, ``.xacro``), or ``menagerie:NAME``. A path may be
            followed by ``#motors=FILE``, a TOML file with ``[[couple]]`` and ``[actuators]``. ``:left`` or
            ``:right`` at the end selects a side.
        side: ``right`` or ``left``; by default the side of the model. The other side is its mirror image.

    Raises:
        UnknownHand: There is no hand of that name.
        HandError: A file is missing or has a fault, or the side is neither ``right`` nor ``left``.
        EnvironmentFailure: A file cannot be read, or a model cannot be fetched.
    """
    text, wanted = _split_side(str(name), side)
    file, motors = split_motors(text)
    if is_description(file):
        return _from_file(Path(file), motors, wanted)
    if is_model(file):
        return _from_model(Path(file), motors, wanted)
    if motors is not None:
        raise HandError(f"--motors belongs to a model or a TOML file, not to the hand {shown(file)}")
    if text not in hand_names() and not text.startswith(menagerie.PREFIX):
        raise UnknownHand(text, hand_names())
    return _by_name(text, wanted)


def is_description(name: str | Path) -> bool:
    """Whether a hand's name is that of a TOML file."""
    return str(name).lower().endswith(".toml")


def is_model(name: str | Path) -> bool:
    """Whether a hand's name is that of a model: a URDF, an MJCF or a xacro."""
    return str(name).lower().endswith(MODELS) and not str(name).startswith(menagerie.PREFIX)


def source_of(name: str | Path) -> str:
    """The name, or the paths of a file and of its motors made absolute: the same hand in every folder."""
    text, side = _split_side(str(name), None)
    file, motors = split_motors(text)
    if is_description(file) or is_model(file):
        text = str(Path(file).absolute())
        text += "" if motors is None else f"{MOTORS}{motors.absolute()}"
    return text if side is None else f"{text}:{side}"


def joined(name: str | Path, motors: str | Path | None) -> str:
    """The source of a hand with a file of motors; ``:left`` and ``:right`` stay at the end."""
    if motors is None:
        return str(name)
    text, side = _split_side(str(name), None)
    return f"{text}{MOTORS}{motors}" + ("" if side is None else f":{side}")


def recorded_hand(record: Mapping[str, Any]) -> Hand:
    """The hand of the ``hand`` object of a plan.json, by its ``source`` or, in older files, its ``name``.

    Raises:
        KeyError: The record has neither.
        InputError: The hand cannot be loaded; see :func:`load_hand`.
    """
    source = str(record.get("source") or record["name"])
    _said.add(_split_side(source, None)[0])  # what was guessed was said when the plan was made
    return load_hand(source)


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


def _from_file(path: Path, motors: Path | None, side: str | None) -> Hand:
    from .compiled import read_model
    from .rewrite import rebuilt

    data = with_motors(read_description(path), motors)
    if data.get("name") in hand_names():
        raise HandError(f"{path}: a built-in hand is called {data['name']}; choose another name")
    hand = rebuilt(data, read_model(model_file(data, path)), str(path))
    return _on_side(replace(hand, source=source_of(joined(path, motors))), side, data)


def with_motors(data: Table, motors: Path | None) -> Table:
    """A description with the laws and motors of a file; see :func:`read_motors`."""
    if motors is None:
        return data
    given = read_motors(motors)
    actuators = data.get("actuators", {})
    if isinstance(actuators, dict):
        given = {**given, "actuators": {**actuators, **given.get("actuators", {})}}
    return {**data, **given}


def read_motors(path: Path) -> Table:
    """The ``[[couple]]`` and ``[actuators]`` tables of a file of motors.

    Raises:
        HandError: There is no such file, it is not TOML, or it contains something else.
        EnvironmentFailure: The file cannot be read.
    """
    data = read_description(path)
    kinds = {"couple": list, "actuators": dict}
    wrong = [key for key, entry in data.items() if not isinstance(entry, kinds.get(key, ()))]
    if wrong or not data:
        raise HandError(
            f"{path}: a file of motors contains [[couple]] tables and an [actuators] table, "
            + (f"not {shown(wrong[0])}" if wrong else "and this one is empty")
        )
    return data


def read_hand_model(path: Path) -> CompiledModel:
    """The model of a file that a user names.

    Raises:
        HandError: There is no such file, or MuJoCo cannot read it.
    """
    from .compiled import read_model

    if not path.is_file():
        raise HandError(f"there is no model {printable(path, 400)}, or it is no regular file")
    return read_model(path)


def guess(source: CompiledModel, path: Path, motors: Path | None) -> Guess:
    """What :func:`~preshape.hands.init.describe` infers for a model, from the cache where it is known."""
    from .init import Guess, describe

    given = None if motors is None else read_motors(motors)
    kept = cache_folder() / "hands" / f"{_digest(source, path, given)}.json"
    try:
        found = loads(read_file(kept, MOST_OF_JSON, "guess"))
        return Guess(data=dict(found["data"]), lines=tuple(map(str, found["lines"])))
    except (OSError, ValueError, KeyError, TypeError, HandError):
        pass  # not there, or damaged: it is made again
    made = describe(source, path, motors=given, taken=hand_names())
    with suppress(OSError, EnvironmentFailure):  # without a cache it is made every time
        kept.parent.mkdir(parents=True, exist_ok=True)
        write_json(kept, {"data": made.data, "lines": list(made.lines)})
    return made


def describe_file(
    model: str,
    *,
    root: str | None = None,
    side: str | None = None,
    motors: str | None = None,
    out: str | None = None,
) -> tuple[Path, Guess, Hand]:
    """Describe the hand of a model in a TOML file; see :func:`~preshape.hands.init.describe`.

    Args:
        model: The model.
        root: The hand's mount.
        side: ``right`` or ``left``.
        motors: A file of motors.
        out: The TOML file; by default it has the hand's name and is in the current folder.

    Returns:
        The file that was written, what it says, and the hand that it describes.

    Raises:
        HandError: The model cannot be used, or the file exists already.
        EnvironmentFailure: The file cannot be written.
    """
    from .init import Guess, describe
    from .rewrite import rebuilt

    if side not in (None, *SIDES):
        raise HandError(f"--side must be right or left, got {shown(side)}")
    if not is_model(model):
        raise HandError(f"a model ends in {', '.join(MODELS)}; got {shown(model)}")
    path = Path(model)
    source = read_hand_model(path)
    given = None if motors is None else read_motors(Path(motors))
    made = describe(source, path, root=root, side=side, motors=given, taken=hand_names())
    file = Path(out) if out is not None else Path(f"{made.data['name']}.toml")
    if not is_description(file):
        raise HandError(f"the file of a hand ends in .toml; got {shown(str(file))}")
    if file.exists():
        raise HandError(f"{file} exists already: choose another file with --out, or remove it")
    data = {**made.data, "model": os.path.relpath(path.absolute(), file.absolute().parent)}
    hand = rebuilt(data, source, path.name)
    make_folder(file.parent)
    write_text(file, toml_text(data, made.lines))
    return file, Guess(data=data, lines=(*source.notes, *made.lines)), replace(hand, source=source_of(file))


@cache
def _program() -> str:
    """Hash of the files that read hands, so that a changed program makes its own guesses."""
    content = hashlib.sha256(__version__.encode())
    for file in sorted(resources.files("preshape.hands").iterdir(), key=lambda file: file.name):
        if file.name.endswith(".py"):
            content.update(file.read_bytes())
    return content.hexdigest()


def _digest(source: CompiledModel, path: Path, motors: Table | None) -> str:
    """Hash of everything that a guess depends on: the compiled model with its meshes, and this program."""
    m = source.model
    content = hashlib.sha256(repr((_program(), path.stem, motors, source.ranges, source.couples)).encode())
    names = (
        m.names,
        m.body_pos,
        m.body_quat,
        m.jnt_pos,
        m.jnt_axis,
        m.jnt_actfrcrange,
        m.geom_pos,
        m.geom_quat,
    )
    for array in (
        *names,
        m.geom_size,
        m.geom_contype,
        m.mesh_vert,
        m.actuator_gainprm,
        m.actuator_forcerange,
    ):
        content.update(array if isinstance(array, bytes) else array.tobytes())
    return content.hexdigest()[:32]


def _from_model(path: Path, motors: Path | None, side: str | None) -> Hand:
    import multiprocessing

    from .rewrite import rebuilt

    model = read_hand_model(path)
    made = guess(model, path, motors)
    source = source_of(joined(path, motors))
    if source not in _said and multiprocessing.parent_process() is None:
        _said.add(source)
        for line in (*model.notes, *made.lines):
            _log.warning("%s", printable(f"{path.name}: {line}", LONGEST_MESSAGE))
    hand = rebuilt(made.data, model, path.name)
    return _on_side(replace(hand, source=source), side, made.data)


@cache
def _by_name(name: str, side: str | None) -> Hand:
    if side is not None:
        hand = _by_name(name, None)
        return hand if side == hand.side else _on_side(hand, side, _description(name)[0])
    data, mjcf = _description(name)
    if name.startswith(menagerie.PREFIX):
        from .compiled import read_model
        from .rewrite import rebuilt

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


def split_motors(text: str) -> tuple[str, Path | None]:
    """The file of a hand, and the file of its motors, from a source without a side.

    Raises:
        HandError: The file of the motors has no name.
    """
    file, found, motors = text.partition(MOTORS)
    if found and not motors.strip():
        raise HandError(f"{MOTORS} needs the name of a file")
    return file, Path(motors) if found else None


def say_guesses_again() -> None:
    """Say the guesses about each model again, because somebody else has asked."""
    _said.clear()


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
