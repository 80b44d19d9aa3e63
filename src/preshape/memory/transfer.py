"""The exported memory: one JSON document.

::

    {
      "format": "preshape-memory",
      "version": 5,
      "experiences": [
        {
          "kind": "task", "object_name": "cube", "hand": "utah_mit",
          "attributes": {"extents": [x, y, z], "vertices": 8, "vertex_normals": 6, "faces": 6,
                         "triangles": 12, "area": m², "volume": m³, "shape": [28 numbers] or null},
          "task": [Tx, Ty, Tz, Rx, Ry, Rz],
          "plane": 1..12, "flip": false, "approach_value": -1..1, "approach_set": 0..6,
          "fingers": 2..4, "wrench": [fx, fy, fz, mx, my, mz], "match": 0..6,
          "created": "2025-01-31T12:00:00.000000+00:00",
          "grip": [x, y, z, w, x, y, z, fingers, joint angles …] or null,
          "quality": 0..6 or null, "outcome": "", "held" or "lost",
          "scene": "" or the table, boxes and unusual load of the lesson,
          "length_unit": "4U", the unit of the wrench, or "U" of older lessons,
          "model": "" or the hash of the real hand's model, 16 hexadecimal digits
        }
      ],
      "weights": [
        {"hand": "utah_mit", "w1": [[…] …], "b1": […], "w2": [[…] …], "b2": […],
         "mean_square_error": 5e-4, "trained_on": 48, "epochs": 900}
      ]
    }

Experiences are in the order in which they were stored. The fields are exactly those of
:class:`~preshape.types.Experience` and :class:`~preshape.types.NetworkWeights`. Numbers have enough digits to
give the same double when read. Older versions are read too: version 1 has neither shape, grip, quality nor
outcome, version 2 has no scene, version 3 no unit of length, version 4 no hash of the model. Of versions
before 4, the weights and the first lessons with virtual grasps are left out, because they are made again with
the new unit.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from ..exceptions import EnvironmentFailure, InputError, MemoryFileError, shown
from ..files import MOST_OF_JSON, loads, read_file, write_text
from ..types import Experience, NetworkWeights
from . import checks, records

FORMAT_NAME = "preshape-memory"
FORMAT_VERSION = 5

_KEYS = ("format", "version", "experiences", "weights")
_T = TypeVar("_T")


def write_document(
    path: Path, experiences: Iterable[Experience], weights: Iterable[tuple[str, NetworkWeights]]
) -> None:
    """Write a document whole or not at all.

    Raises:
        EnvironmentFailure: The file cannot be written; an existing file at ``path`` is unchanged.
    """
    document = {
        "format": FORMAT_NAME,
        "version": FORMAT_VERSION,
        "experiences": [records.experience_fields(experience) for experience in experiences],
        "weights": [records.weights_fields(hand, content) for hand, content in weights],
    }
    content = json.dumps(document, allow_nan=False, ensure_ascii=False, indent=1) + "\n"
    try:
        write_text(path, content)
    except ValueError as error:  # a path that no file can have
        raise EnvironmentFailure(f"cannot write {path}: {error}; choose another file") from error


def read_document(
    path: Path,
) -> tuple[tuple[Experience, ...], tuple[tuple[str, NetworkWeights], ...]]:
    """Read a document and check all its fields.

    Raises:
        MemoryFileError: The file is not such a document; the message says where it violates the format.
        EnvironmentFailure: The file cannot be read.
    """
    try:
        raw = read_file(path, MOST_OF_JSON, "memory export", refusal=MemoryFileError)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise EnvironmentFailure(f"cannot import {path} ({reason}); check the path") from error
    try:
        document = loads(raw.decode("utf-8"), parse_constant=_no_constant, object_pairs_hook=_unique_names)
    except ValueError as error:
        raise MemoryFileError(f"{path} is not a JSON document ({str(error)[:200]}); {_REMEDY}") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT_NAME:
        raise MemoryFileError(f'{path} does not say "format": "{FORMAT_NAME}"; {_REMEDY}')
    version = document.get("version")
    if isinstance(version, int) and version > FORMAT_VERSION:
        raise MemoryFileError(
            f"{path} has format version {version}, newer than the {FORMAT_VERSION} known here;"
            " upgrade preshape"
        )
    try:
        version = checks.whole(version, "version", 1, FORMAT_VERSION)
        checks.exactly(document, _KEYS, "the document")
        experiences = _each(
            document["experiences"], "experience", lambda item: records.older_experience_from(item, version)
        )
        weights = _each(document["weights"], "weights", records.weights_from)
        if len({hand for hand, _ in weights}) != len(weights):
            raise InputError("a hand has more than one set of weights")
        if version < records.SINCE_LENGTH_UNIT:
            weights = ()
            experiences = tuple(e for e in experiences if not records.superseded(e))
    except InputError as error:
        raise MemoryFileError(f"{path}: {error}; nothing was imported") from error
    return experiences, weights


_REMEDY = "give a file written by memory export; nothing was imported"


def _each(items: object, noun: str, build: Callable[[object], _T]) -> tuple[_T, ...]:
    if not isinstance(items, list):
        raise InputError(f"{noun}: a list was expected, got {shown(items)}")
    built = []
    for position, item in enumerate(items, start=1):
        try:
            built.append(build(item))
        except InputError as error:
            raise InputError(f"{noun} {position}: {error}") from error
    return tuple(built)


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is not a finite number")


def _unique_names(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) != len(pairs):
        raise ValueError("a name appears twice in one object")
    return result
