"""Answers that were given before: the same request over the same memory and files needs no other search.

An answer depends on the request, the memory, the files that the request names, and the program alone. So a
document may stand in the user's cache under the state of all of them; whatever changes one of these leaves it
unused. A lesson changes the memory, so what a search has taught something is never kept.
"""

from __future__ import annotations

import json
import os
import sys
import zlib
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from .._version import __version__
from ..exceptions import EnvironmentFailure, InputError
from ..files import MOST_OF_JSON, cache_folder, file_state, loads, read_file, write_whole
from ..hands.load import is_description, is_model
from ..objects.load import split_part
from ..objects.obstacle import placed_file
from ..objects.sidecar import sidecar_path
from .request import PlanRequest

MOST = 500
"""Number of answers that are kept; the oldest are removed first."""


def object_state(request: PlanRequest) -> tuple[Any, ...]:
    """Names a loaded object; with a new file or a new sidecar it is another object."""
    source = str(request.source)
    path = split_part(source)[0]
    state = tuple(file_state(file) for file in (path, sidecar_path(path), str(request.mask or "")))
    return source, request.unit, request.scale, request.view, request.cut_table, request.mask, state


def obstacle_states(request: PlanRequest) -> list[str]:
    """The states of the files of obstacles, which may change under their names."""
    return [repr(file_state(split_part(placed_file(text).file)[0])) for text in request.obstacle]


def names_all_files(request: PlanRequest) -> bool:
    """Whether the request names every file that its answer depends on.

    The file of a hand or an arm names meshes, and a glTF file others with its vertices.
    """
    if request.arm is not None:
        return False
    files = [request.object_name, *(placed_file(text).file for text in request.obstacle)]
    named = any(split_part(file)[0].lower().endswith((".gltf", ".glb")) for file in files)
    return not named and not is_model(request.hand_name) and not is_description(request.hand_name)


def answer_key(request: PlanRequest) -> str | None:
    """The request and the state of everything else that its answer depends on.

    Returns:
        The text; ``None`` if some of it is unknown, or if the memory is no file.
    """
    from ..memory import default_path

    memory = os.path.realpath(os.path.expanduser(request.memory or default_path()))
    stored = file_state(memory)
    if request.memory == ":memory:" or stored is None or not names_all_files(request):
        return None
    states = (memory, stored, file_state(f"{memory}-wal"), object_state(request), obstacle_states(request))
    return json.dumps([request.to_json(), repr(states), _program()])


@cache
def _program() -> str:
    """The state of this program, of the packages beside NumPy, and the machine."""
    import numpy as np

    newest, package = 0, Path(__file__).parents[1]
    for folder, _, files in os.walk(package):
        states = [file_state(os.path.join(folder, file)) for file in files if not file.endswith(".pyc")]
        newest = max([newest, *(max(state[3:]) for state in states if state is not None)])
    packages = file_state(Path(np.__file__).parents[1])
    machine = os.uname() if hasattr(os, "uname") else ""
    return repr((__version__, sys.version, str(package), newest, packages, machine))


def known_answer(key: str) -> tuple[dict[str, Any], int] | None:
    """The document and the exit code that were kept under a key; ``None`` if there are none.

    A file that is damaged counts as none.
    """
    with suppress(OSError, ValueError, KeyError, TypeError, InputError):
        kept = loads(read_file(_file(key), MOST_OF_JSON))
        text = kept["document"]
        if kept["key"] == key and kept["check"] == zlib.crc32(text.encode()):
            return loads(text), int(kept["code"])
    return None


def keep_answer(key: str, document: dict[str, Any], code: int) -> None:
    """Keep a document and its exit code under a key; without a usable cache they are not kept."""
    text, path = json.dumps(document, allow_nan=False), _file(key)
    kept = json.dumps({"key": key, "check": zlib.crc32(text.encode()), "code": code, "document": text})

    def write(target: Path) -> None:
        target.write_text(kept, encoding="utf-8")

    with suppress(EnvironmentFailure, OSError):
        write_whole(path, write)
        files = sorted(path.parent.glob("*.json"), key=lambda file: file.stat().st_mtime_ns)
        for file in files[:-MOST]:
            file.unlink(missing_ok=True)


def _file(key: str) -> Path:
    import hashlib

    return cache_folder() / "answers" / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.json"
