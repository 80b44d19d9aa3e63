"""All readers of files, and the promise that each of them makes for any file.

A file is read, or it is refused with an error of preshape whose message is one printable line. There is no
other exception, no crash, no hang, and no excessive use of memory.
"""

from __future__ import annotations

import contextlib
import random
import unicodedata
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from preshape.arm.model import read_arm
from preshape.cli.settings_file import user_settings
from preshape.exceptions import EnvironmentFailure, MemoryFileError, PreshapeError
from preshape.export.drivers import load_driver
from preshape.hands.load import load_hand, parse_hand
from preshape.memory import Memory
from preshape.memory.transfer import read_document
from preshape.objects.load import load_object, read_content
from preshape.objects.scans.read_points import read_xyz
from preshape.objects.scans.scan import RawCloud
from preshape.objects.scans.scene import object_mask
from preshape.objects.sidecar import read_sidecar
from preshape.physics.grasps import read_grasps
from preshape.planning.grasp_sets import read_grasp_file

from . import pincer
from .mutate import mutated_glb, mutated_json, mutated_memory, mutated_npz, mutated_toml, mutated_xml

LONGEST_MESSAGE = 2000
"""Largest length of an error message [characters]."""

Mutate = Callable[[bytes, int], bytes]
Mutator = Callable[[bytes, int, random.Random, Mutate], bytes]


class Fault(Exception):
    """A reader broke its promise."""


@dataclass(frozen=True, kw_only=True)
class Reader:
    """One reader.

    Attributes:
        file: Name of the file under test.
        read: Reads the file; raises a ``PreshapeError`` to refuse it.
        largest: Largest size of an input [bytes].
        mutate: Makes a new input with a valid structure from another; ``None`` changes single bytes.
        words: Words of the format that the fuzzer tries.
    """

    file: str
    read: Callable[[Path], object]
    largest: int = 4096
    mutate: Mutator | None = None
    words: tuple[str, ...] = ()


def _mesh(path: Path) -> None:
    mesh = load_object(path)
    if not (mesh.area > 0 and (mesh.extents > 0).all()):
        raise Fault(f"a mesh without a surface was accepted: {mesh.extents}, area {mesh.area}")


def _cloud(path: Path) -> None:
    """Read a cloud as far as its points; the surface of one takes too long for so many inputs."""
    cloud = read_content(path)
    if not isinstance(cloud, RawCloud):
        raise Fault(f"a cloud was read as a {type(cloud).__name__}")
    n = len(cloud.points)
    if cloud.points.shape != (n, 3) or not (cloud.labels is None or cloud.labels.shape == (n,)):
        raise Fault(f"points of shape {cloud.points.shape} were accepted")


def _mask(path: Path) -> None:
    """Take the object of a small scene with a mask."""
    scene = read_xyz("scene.xyz", b"\n".join(b"0 0 %d" % k for k in range(1, 17)))
    if object_mask("scene.xyz", scene, str(path)).shape != (16,):
        raise Fault("a mask of another size was accepted")


def _settings(path: Path) -> None:
    """Read the settings of a folder, as the command line does."""
    with contextlib.chdir(path.parent):
        user_settings()


def _sidecar(path: Path) -> None:
    read_sidecar(path.with_name("a.obj"))


def _arm(path: Path) -> None:
    read_arm(path, "tip", load_hand("leap"), np.eye(4))


def _hand_toml(path: Path) -> None:
    path.with_name("pincer.xml").write_text(pincer.MJCF)
    with suppress(PreshapeError, UnicodeDecodeError):
        if path.is_file():
            parse_hand(path.read_text(encoding="utf-8"), pincer.MJCF)
    load_hand(path)


def _hand_mjcf(path: Path) -> None:
    toml = path.with_name("hand.toml")
    toml.write_text(pincer.TOML)
    with suppress(PreshapeError, UnicodeDecodeError):
        if path.is_file():
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
                if memory.skipped:
                    raise MemoryFileError(memory.remark)
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
_SIDECAR = ("mass", "tasks", "rest", "up", "[part.", "box", "half_space", "cylinder", "group", "from", "rule")
_PCD = (
    *("VERSION .7\n", "FIELDS x y z\n", "SIZE 4 4 4\n", "TYPE F F F\n", "COUNT 1 1 1\n", "WIDTH ", "HEIGHT "),
    *(
        "POINTS ",
        "VIEWPOINT 0 0 0 1 0 0 0\n",
        "DATA ascii\n",
        "DATA binary\n",
        "DATA binary_compressed\n",
        "nan",
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
    "pcd": Reader(file="a.pcd", read=_cloud, largest=16384, words=_PCD),
    "xyz": Reader(
        file="a.xyz", read=_cloud, words=("nan", "inf", "1e999", ",", ";", "#", "//", "\t", "1 2 3\n")
    ),
    "npy": Reader(
        file="a.npy",
        read=_cloud,
        words=("'descr'", "'<f8'", "'|O'", "'shape'", "(9999999, 3)", "True", "\x93NUMPY"),
    ),
    "scene-npz": Reader(file="a.npz", read=_cloud, largest=16384, mutate=mutated_npz),
    "mask": Reader(
        file="a.npy", read=_mask, words=("'descr'", "'|b1'", "'|u1'", "'shape'", "IHDR", "PLTE", "tRNS")
    ),
    "sidecar": Reader(file="a.preshape.toml", read=_sidecar, mutate=mutated_toml, words=(*_TOML, *_SIDECAR)),
    "settings": Reader(
        file="preshape.toml",
        read=_settings,
        mutate=mutated_toml,
        words=(*_TOML, "hand", "table", "mass", "memory"),
    ),
    "driver": Reader(
        file="a.toml",
        read=lambda path: load_driver(str(path)),
        mutate=mutated_toml,
        words=(*_TOML, "channel", "offset", "sign", "scale"),
    ),
    "arm": Reader(file="arm.urdf", read=_arm, mutate=mutated_xml, words=_URDF),
    "hand-toml": Reader(file="hand.toml", read=_hand_toml, mutate=mutated_toml, words=_TOML),
    "hand-mjcf": Reader(file="pincer.xml", read=_hand_mjcf, mutate=mutated_xml, words=_XML),
    "hand-urdf": Reader(file="pincer.urdf", read=_hand_urdf, mutate=mutated_xml, words=_URDF),
    "grasps-npz": Reader(file="a.npz", read=read_grasps, largest=16384, mutate=mutated_npz),
    "plan-json": Reader(file="a.json", read=read_grasp_file, largest=16384, mutate=mutated_json, words=_JSON),
    "memory": Reader(file="a.sqlite", read=_memory, largest=65536, mutate=mutated_memory),
    "memory-json": Reader(file="a.json", read=read_document, largest=16384, mutate=mutated_json, words=_JSON),
}
"""All readers by name."""


def attempt(reader: Reader, folder: Path, data: bytes) -> str:
    """Give one file to a reader.

    Args:
        reader: The reader.
        folder: Folder for the file; other files may be left in it.
        data: Content of the file.

    Returns:
        Empty where the file was read, else the message with which it was refused.

    Raises:
        Fault: The reader broke its promise.
    """
    path = folder / reader.file
    path.write_bytes(data)
    return attempt_file(reader, path)


def attempt_file(reader: Reader, path: Path) -> str:
    """Let a reader read what is at a path; see :func:`attempt`."""
    try:
        with warnings.catch_warnings(record=True) as shown:
            warnings.simplefilter("always")
            reader.read(path)
    except PreshapeError as error:
        message = str(error)
        if isinstance(error, EnvironmentFailure) and isinstance(error.__cause__, MemoryError):
            size = path.stat().st_size
            raise Fault(f"{size} bytes exhausted the memory: {message}") from error
        if not message or len(message) > LONGEST_MESSAGE:
            raise Fault(f"a message of {len(message)} characters: {message:.200}") from error
        if any(unicodedata.category(letter) in {"Cc", "Cs"} for letter in message):
            raise Fault(f"a message that is not one printable line: {message!r:.300}") from error
        return message
    except Fault:
        raise
    except Exception as error:
        raise Fault(f"{type(error).__name__}: {str(error)[:300]!r}") from error
    if shown:
        raise Fault(f"a warning reaches the user: {shown[0].category.__name__}: {shown[0].message}")
    return ""
