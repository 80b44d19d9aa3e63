"""Meshes that clients send: kept in temporary files under a number made from their content."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from ..app.uploads import LARGEST, Uploads
from ..exceptions import InputError, shown

PREFIX = "upload:"
"""What the name of a mesh that was sent begins with."""
MOST, MOST_BYTES = 256, 5 * LARGEST
"""Largest number of meshes that are kept, and of their bytes together; the oldest go first."""


class Sent(NamedTuple):
    """A mesh that was sent.

    Attributes:
        path: Its file.
        name: What the client calls it.
        size: Its size [bytes].
    """

    path: Path
    name: str
    size: int


class Shelf:
    """The meshes of all clients, deleted when the server ends."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[str, tuple[Uploads, Sent]] = OrderedDict()
        self._open = True

    def put(self, name: str, size: int, parts: Iterable[bytes]) -> str:
        """Store a mesh, each part as it comes; returns the name by which requests ask for it.

        Args:
            name: The name of its file; its ending says the format.
            size: Its size [bytes].
            parts: Its content.

        Raises:
            InputError: The format is not supported, or the size is 0 or above 200 MB.
            EnvironmentFailure: It cannot be written.
        """
        uploads = Uploads()
        try:
            uploads.begin(name, size)
            digest, path = hashlib.sha256(name.encode("utf-8", "replace") + b"\0"), None
            for part in parts:
                digest.update(part)
                path = uploads.add(part)
            if path is None:
                raise InputError(f"{shown(name)}: fewer than {size} bytes came; send it again")
        except BaseException:
            uploads.close()
            raise
        number = digest.hexdigest()[:24]
        with self._lock:
            old = self._kept.pop(number, None)
            self._kept[number] = old or (uploads, Sent(path, path.name, size))
            dropped = [uploads] if old or not self._open else []
            while len(self._kept) > MOST or sum(sent.size for _, sent in self._kept.values()) > MOST_BYTES:
                dropped.append(self._kept.popitem(last=False)[1][0])
        for each in dropped:
            each.close()
        return PREFIX + number

    def get(self, name: str) -> Sent:
        """The mesh of a name that :meth:`put` returned.

        Raises:
            InputError: There is none, because it was never sent or is no longer kept.
        """
        with self._lock:
            found = self._kept.get(name.removeprefix(PREFIX))
            if found is None:
                raise InputError(f"no mesh {shown(name)} was sent to this server, or it is no longer kept")
            self._kept.move_to_end(name.removeprefix(PREFIX))
            return found[1]

    def close(self) -> None:
        """Delete all meshes; later ones are not kept."""
        with self._lock:
            self._open = False
            kept, self._kept = list(self._kept.values()), OrderedDict()
        for uploads, _ in kept:
            uploads.close()
