"""Everything of preshape that reads a file, and what every one of them promises of any file whatever.

A file is read, or refused with an error of preshape's own whose message is one printable line. Nothing else
may come out: no foreign exception, no crash, no hang, and no use of memory out of proportion.
"""

from __future__ import annotations

import random
import unicodedata
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from preshape.exceptions import EnvironmentFailure, PreshapeError
from preshape.hands.load import load_hand, parse_hand
from preshape.memory import Memory
from preshape.memory.transfer import read_document
from preshape.objects.load import load_object
from preshape.physics.grasps import read_grasps
from preshape.planning.grasp_sets import read_grasp_file

from . import pincer
from .mutate import mutated_glb, mutated_json, mutated_memory, mutated_npz, mutated_toml, mutated_xml

LONGEST_MESSAGE = 2000
"""Characters."""

Mutate = Callable[[bytes, int], bytes]
Mutator = Callable[[bytes, int, random.Random, Mutate], bytes]


class Fault(Exception):
    """A reader broke its promise."""


@dataclass(frozen=True, kw_only=True)
class Reader:
    """One reader.

    Attributes:
        file: what the file under test is called.
        read: reads it; raises a ``PreshapeError`` where it refuses.
        largest: bytes of an input at most.
        mutate: makes a new input of one with the framing kept right; ``None`` changes single bytes.
        words: of the format, for the fuzzer to try.
    """

    file: str
    read: Callable[[Path], object]
    largest: int = 4096
    mutate: Mutator | None = None
    words: tuple[str, ...] = ()


def _mesh(path: Path) -> None:
    mesh = load_object(path)
    if not (mesh.area > 0 and (mesh.extents > 0).all()):
        raise Fault(f"a mesh without body was let through: {mesh.extents}, area {mesh.area}")


def _hand_toml(path: Path) -> None:
    path.with_name("pincer.xml").write_text(pincer.MJCF)
    with suppress(PreshapeError, UnicodeDecodeError):
        parse_hand(path.read_text(encoding="utf-8"), pincer.MJCF)
    load_hand(path)


def _hand_mjcf(path: Path) -> None:
    toml = path.with_name("hand.toml")
    toml.write_text(pincer.TOML)
    with suppress(PreshapeError, UnicodeDecodeError):
        parse_hand(pincer.TOML, path.read_text(encoding="utf-8"))
    load_hand(toml)


def _hand_urdf(path: Path) -> None:
    toml = path.with_name("hand.toml")
    toml.write_text(pincer.TOML.replace("pincer.xml", path.name))
    load_hand(toml)


def _memory(path: Path) -> None:
    try:
        for read_only in (True, False):
            with Memory.open(path, read_only=read_only) as memory:
                memory.statistics()
                memory.objects()
                memory.weights(pincer.HAND)
                memory.experiences()
    finally:
        for beside in path.parent.glob(f"{path.name}[-.]*"):
            beside.unlink()


_XML = (
    *(
        "<mujoco>",
        "<worldbody>",
        "<body",
        "<joint",
        "<geom",
        "<site",
        "<default",
        "<include file=",
        "<asset>",
    ),
    *("<mesh", "<replicate count=", "<frame", "<inertial", "<composite", "<size", "<compiler", "<tendon>"),
    *("range=", "pos=", "quat=", "euler=", "fromto=", "size=", "type=", "mesh=", "nan", "inf", "1e308", "-1"),
)
_URDF = (
    *("<robot", "<link", "<joint", "<origin", "<limit", "<axis", "<mesh filename=", "<inertial>", "<mimic"),
    *("package://", "file://", "continuous", "fixed", "prismatic", "floating", "planar", "nan", "1e308"),
)
_TOML = (
    *("[[finger]]", "[palm]", "[actuators]", "closing", "open", "rest", "closed", "preshape", "couplings"),
    *(
        "fixed",
        "root",
        "side",
        "nan",
        "inf",
        "1e400",
        "true",
        "'''",
        "2020-01-01",
        "0x",
        "[[",
        "{",
        "left_names",
    ),
)
_JSON = ("null", "true", "NaN", "Infinity", "1e999", "-0", "[[", "{}", "[]", '"', "\\u0000", "\\ud800")

READERS: dict[str, Reader] = {
    "obj": Reader(
        file="a.obj", read=_mesh, words=("v ", "f ", "vn ", "//", "nan", "1e999", "\\\n", "-1", "#")
    ),
    "stl": Reader(
        file="a.stl", read=_mesh, words=("solid", "facet normal", "outer loop", "vertex", "endsolid")
    ),
    "ply": Reader(
        file="a.ply",
        read=_mesh,
        words=(
            *(
                "ply\n",
                "format ascii 1.0\n",
                "format binary_big_endian 1.0\n",
                "element vertex ",
                "end_header\n",
            ),
            *(
                "element face ",
                "property list uchar int vertex_index\n",
                "property double x\n",
                "comment ",
                "nan",
            ),
        ),
    ),
    "off": Reader(file="a.off", read=_mesh, words=("OFF", "COFF", "STOFF", "BINARY", "#", "nan", "-1")),
    "gltf": Reader(
        file="a.gltf",
        read=_mesh,
        mutate=mutated_json,
        words=(
            *_JSON,
            "accessors",
            "bufferViews",
            "sparse",
            "matrix",
            "extensionsRequired",
            "children",
            "uri",
        ),
    ),
    "glb": Reader(file="a.glb", read=_mesh, mutate=mutated_glb, words=_JSON),
    "hand-toml": Reader(file="hand.toml", read=_hand_toml, mutate=mutated_toml, words=_TOML),
    "hand-mjcf": Reader(file="pincer.xml", read=_hand_mjcf, mutate=mutated_xml, words=_XML),
    "hand-urdf": Reader(file="pincer.urdf", read=_hand_urdf, mutate=mutated_xml, words=_URDF),
    "grasps-npz": Reader(file="a.npz", read=read_grasps, largest=16384, mutate=mutated_npz),
    "plan-json": Reader(file="a.json", read=read_grasp_file, largest=16384, mutate=mutated_json, words=_JSON),
    "memory": Reader(file="a.sqlite", read=_memory, largest=65536, mutate=mutated_memory),
    "memory-json": Reader(file="a.json", read=read_document, largest=16384, mutate=mutated_json, words=_JSON),
}
"""Every reader by its name."""


def attempt(reader: Reader, folder: Path, data: bytes) -> str:
    """Put one file to a reader.

    Args:
        reader: which.
        folder: of its own; files may be left in it.
        data: the file's content.

    Returns:
        Empty where it was read, or the sentence with which it was refused.

    Raises:
        Fault: the reader broke its promise.
    """
    path = folder / reader.file
    path.write_bytes(data)
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            reader.read(path)
    except PreshapeError as error:
        message = str(error)
        if isinstance(error, EnvironmentFailure) and isinstance(error.__cause__, MemoryError):
            raise Fault(f"{len(data)} bytes exhausted the memory: {message}") from error
        if not message or len(message) > LONGEST_MESSAGE:
            raise Fault(f"a message of {len(message)} characters: {message:.200}") from error
        if any(unicodedata.category(letter) in {"Cc", "Cs"} for letter in message):
            raise Fault(f"a message that does not print in one line: {message!r:.300}") from error
        return message
    except Fault:
        raise
    except Exception as error:
        raise Fault(f"{type(error).__name__}: {str(error)[:300]!r}") from error
    if said:
        raise Fault(f"a warning reaches people: {said[0].category.__name__}: {said[0].message}")
    return ""
