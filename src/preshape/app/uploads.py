"""Uploaded meshes: checked first, then written to a temporary folder under safe names."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

from ..exceptions import EnvironmentFailure, InputError
from ..objects.load import SUFFIXES

LARGEST = 200 * 2**20
"""Largest size of an upload [bytes]."""


class Uploads:
    """The uploads of one browser, deleted when it closes."""

    def __init__(self) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._count = 0

    def keep(self, name: str, content: bytes) -> Path:
        """Write an upload to its own folder; only letters, digits, ``-`` and ``_`` of its name are kept.

        Raises:
            InputError: The file is too large, or its format is not supported.
            EnvironmentFailure: The file cannot be written.
        """
        bare = name.replace("\\", "/").rsplit("/", 1)[-1].replace("\0", "")
        stem, dot, suffix = bare.rpartition(".")
        ending = f".{suffix.lower()}" if dot else ""
        if ending not in SUFFIXES:
            raise InputError(
                f"{bare:.60}: a mesh file ends in {', '.join(SUFFIXES)}; convert it to one of them"
            )
        if len(content) > LARGEST:
            raise InputError(f"{bare:.60}: the file has over {LARGEST // 2**20} MB; simplify the mesh")
        safe = re.sub(r"[^A-Za-z0-9_-]+", "_", stem).strip("_")[:40] or "object"
        try:
            if self._folder is None:
                self._folder = tempfile.TemporaryDirectory(prefix="preshape-")
            self._count += 1
            path = Path(self._folder.name) / str(self._count) / f"{safe}{ending}"
            path.parent.mkdir()
            path.write_bytes(content)
        except OSError as error:
            raise EnvironmentFailure(f"the upload cannot be written: {error.strerror or error}") from error
        return path

    def close(self) -> None:
        """Delete the uploads."""
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None
