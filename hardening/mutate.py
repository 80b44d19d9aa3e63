"""Mutations that keep the structure of a file valid: its checksums, lengths or grammar."""

from __future__ import annotations

import io
import json
import random
import sqlite3
import struct
import zipfile
from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

Mutate = Callable[[bytes, int], bytes]

_VALUES: tuple[Any, ...] = (
    *(None, True, False, -1, 0, 1, 7, 0.5, -0.0, 1e308, 1e-308, 2**31, 2**63, 2**70, 10**400, float("nan")),
    *(
        float("inf"),
        "",
        "x" * 99,
        "\x1b[31m",
        "\ud800",
        "\0",
        "../a",
        [],
        {},
        [[]],
        [0, 0, 0],
        [1, 2],
        ["a"],
        {"a": 1},
    ),
)


def mutated_json(data: bytes, largest: int, rng: random.Random, mutate: Mutate) -> bytes:
    """A JSON document with values or keys replaced, removed, duplicated or moved."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return mutate(data, largest)
    if rng.random() < 0.3:
        return mutate(data, largest)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        places = list(_places(document))
        if not places:
            break
        holder, key = rng.choice(places)
        match rng.randrange(8):
            case 0:
                del holder[key]
            case 1:
                other, name = rng.choice(places)
                if name in other if isinstance(other, dict) else name < len(other):
                    holder[key] = json.loads(json.dumps(other[name]))
            case 2 if isinstance(holder, list):
                holder.insert(key, holder[key])
            case 2:
                holder["".join(rng.choices("abuv_", k=3))] = holder[key]
            case 3 if isinstance(holder[key], int | float) and not isinstance(holder[key], bool):
                holder[key] += rng.choice((-1, 1, 1e-9, 100, -1000))
            case 4:
                holder[key] = [holder[key]] * rng.randrange(4)
            case _:
                holder[key] = rng.choice(_VALUES)
    return json.dumps(document, separators=(",", ":")).encode()[:largest]


def _places(node: Any) -> Any:
    """Every container with each of its keys."""
    keys = node if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
    for key in keys:
        yield node, key
        yield from _places(node[key])


_WORDS = (
    *(
        "0",
        "-1",
        "1",
        "nan",
        "inf",
        "-inf",
        "1e308",
        "1e-308",
        "1e999",
        "2147483648",
        "0 0 0",
        "0 0 0 0",
        "1 0 0",
    ),
    *(
        "1 -1",
        "0 0",
        "",
        "x",
        "free",
        "ball",
        "slide",
        "hinge",
        "mesh",
        "plane",
        "ellipsoid",
        "cylinder",
        "fixed",
    ),
    *(
        "prismatic",
        "continuous",
        "floating",
        "true",
        "a",
        "b",
        "palm",
        "a1",
        "b2",
        "world",
        "\u00e9",
        "1e20",
        "-0.0",
    ),
)
_ATTRIBUTES = (
    *(
        "name",
        "pos",
        "quat",
        "euler",
        "axisangle",
        "xyaxes",
        "zaxis",
        "range",
        "limited",
        "axis",
        "type",
        "size",
    ),
    *(
        "fromto",
        "mass",
        "density",
        "class",
        "childclass",
        "ref",
        "damping",
        "armature",
        "mesh",
        "contype",
        "mocap",
    ),
    *(
        "angle",
        "xyz",
        "rpy",
        "lower",
        "upper",
        "link",
        "radius",
        "length",
        "filename",
        "scale",
        "file",
        "value",
    ),
)


def mutated_xml(data: bytes, largest: int, rng: random.Random, mutate: Mutate) -> bytes:
    """An XML document with elements removed, duplicated or moved, or attributes changed."""
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError):
        return mutate(data, largest)
    if rng.random() < 0.3:
        return mutate(data, largest)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        pairs = [(parent, child) for parent in root.iter() for child in parent]
        if not pairs:
            break
        parent, child = rng.choice(pairs)
        match rng.randrange(10):
            case 0:
                parent.remove(child)
            case 1:
                rng.choice(pairs)[0].append(ElementTree.fromstring(ElementTree.tostring(child)))
            case 2:
                child.tag = rng.choice(pairs)[1].tag
            case 3 if child.attrib:
                del child.attrib[rng.choice(sorted(child.attrib))]
            case 4:
                child.set(rng.choice(_ATTRIBUTES), rng.choice(_WORDS))
            case _ if child.attrib:
                child.set(rng.choice(sorted(child.attrib)), rng.choice(_WORDS))
            case _:
                child.set("name", rng.choice(_WORDS))
    return ElementTree.tostring(root)[:largest]


_TOML_VALUES = (
    *(
        "0",
        "-1",
        "1e308",
        "nan",
        "inf",
        "-inf",
        "true",
        '""',
        '"x"',
        '"+x"',
        "[]",
        "{}",
        "[[]]",
        "[0, 0, 0]",
        "[nan]",
    ),
    *(
        "2020-01-01",
        "12:00:00",
        "1" * 400,
        "[[0.0, 0.0], [0.1, 0.1]]",
        "[[0.0], [0.1, 0.1]]",
        '["a1", "a2"]',
        "0x7f",
    ),
    *(
        "{ a1 = [0, 1] }",
        "{ a1 = 1 }",
        '[["a1", "a2"]]',
        '[["a1"]]',
        '"left"',
        '"a"',
        '"palm"',
        "[1, 2, [3]]",
        "[[[0]]]",
    ),
)
_TOML_KEYS = (
    *(
        "name",
        "u",
        "finger_pitch",
        "fingertip_width",
        "side",
        "root",
        "fixed",
        "couplings",
        "left_names",
        "palm",
    ),
    *(
        "finger",
        "actuators",
        "joints",
        "tip_site",
        "tip_pos",
        "tip_points",
        "closing",
        "open",
        "rest",
        "closed",
    ),
    *(
        "preshape",
        "body",
        "site",
        "points",
        "faces",
        "pos",
        "gains",
        "torque_limits",
        "model",
        "mjcf",
        "title",
    ),
)


def mutated_toml(data: bytes, largest: int, rng: random.Random, mutate: Mutate) -> bytes:
    """A TOML description with lines removed, duplicated, moved, or with another key or value."""
    if rng.random() < 0.3:
        return mutate(data, largest)
    lines = data.decode("utf-8", "replace").splitlines() or [""]
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        at = rng.randrange(len(lines))
        key, equals, value = lines[at].partition(" = ")
        match rng.randrange(8):
            case 0 if len(lines) > 1:
                del lines[at]
            case 1:
                lines.insert(rng.randrange(len(lines) + 1), lines[at])
            case 2:
                lines.insert(at, f"{rng.choice(_TOML_KEYS)} = {rng.choice(_TOML_VALUES)}")
            case 3 if equals:
                lines[at] = f"{rng.choice(_TOML_KEYS)} = {value}"
            case 4 if equals:
                lines[at] = f"{key} = [{value}]"
            case _ if equals:
                lines[at] = f"{key} = {rng.choice(_TOML_VALUES)}"
            case _:
                lines[at] = rng.choice(lines)
    return "\n".join(lines).encode()[:largest]


def mutated_npz(data: bytes, largest: int, rng: random.Random, mutate: Mutate) -> bytes:
    """An NPZ archive with one member changed, removed or replaced by another; sometimes raw bytes."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {info.filename: archive.read(info) for info in archive.infolist()[:20]}
    except Exception:
        return mutate(data, largest)
    if not members or rng.random() < 0.05:
        return mutate(data, largest)
    name = rng.choice(sorted(members))
    match rng.randrange(10):
        case 0:
            del members[name]
        case 1:
            members[name] = members[rng.choice(sorted(members))]
        case _:
            members[name] = mutate(members[name], max(1, largest // 4))
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for member, inside in members.items():
            archive.writestr(zipfile.ZipInfo(member), inside)
    return content.getvalue()[:largest]


def mutated_glb(data: bytes, largest: int, rng: random.Random, mutate: Mutate) -> bytes:
    """A binary glTF with one of its two chunks changed and the lengths corrected."""
    if len(data) < 20 or not data.startswith(b"glTF") or rng.random() < 0.1:
        return mutate(data, largest)
    end = 20 + int.from_bytes(data[12:16], "little")
    text, body = data[20:end], data[end + 8 :]
    if rng.random() < 0.8:
        text = mutated_json(text, max(1, largest // 2), rng, mutate)
    else:
        body = mutate(body, max(1, largest // 2))
    text += b" " * (-len(text) % 4)
    body += b"\0" * (-len(body) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
    return (struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)[:largest]


_ODD = (
    None,
    "",
    "task",
    -1,
    0,
    7,
    2**62,
    1e308,
    float("inf"),
    b"",
    b"\0" * 8,
    b"\xff" * 64,
    "\x1b[31m",
    "x" * 99,
)


def mutated_memory(data: bytes, largest: int, rng: random.Random, mutate: Mutate) -> bytes:
    """A memory file with one cell set to an unusual value, or with changed bytes."""
    if rng.random() < 0.5:
        return mutate(data, largest)
    connection = sqlite3.connect(":memory:")
    try:
        connection.deserialize(data)
        table = rng.choice(("experiences", "weights"))
        columns = [row[1] for row in connection.execute(f"PRAGMA table_info({table})")]
        column = rng.choice(columns)
        value = rng.choice(_ODD)
        if rng.random() < 0.3:
            old = connection.execute(f"SELECT {column} FROM {table}").fetchone()[0]
            value = mutate(old, len(old) + 8) if isinstance(old, bytes) else -old if old else 1
        connection.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = 1", (value,))
        connection.commit()
        return bytes(connection.serialize())[:largest]
    except (sqlite3.Error, TypeError, IndexError, OverflowError, UnicodeError, MemoryError):
        return mutate(data, largest)
    finally:
        connection.close()
