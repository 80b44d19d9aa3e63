"""Uploaded meshes: each part is written to a temporary folder as it comes, under a safe name."""

from __future__ import annotations

import re
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..exceptions import EnvironmentFailure, InputError, PreshapeError
from ..objects.load import SUFFIXES

if TYPE_CHECKING:
    import viser

LARGEST = 200 * 2**20
"""Largest size of an upload [bytes]."""
ALL_LARGEST = 5 * LARGEST
"""Largest size of all uploads of one browser [bytes]."""


class Uploads:
    """The uploads of one page, deleted when their last holder closes them. One file is received at a time."""

    def __init__(self) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._holders, self._lock = 1, threading.Lock()
        self._count = self._total = self._left = 0
        self._path = Path()

    def begin(self, name: str, size: int) -> None:
        """Begin a file of its own folder; only letters, digits, ``-`` and ``_`` of its name are kept.

        Args:
            name: What the file is called in the browser.
            size: Size of the file [bytes].

        Raises:
            InputError: The file is empty or too large, or its format is not supported.
            EnvironmentFailure: The file cannot be written, or the uploads are closed.
        """
        bare = name.replace("\\", "/").rsplit("/", 1)[-1].replace("\0", "")
        stem, dot, suffix = bare.rpartition(".")
        ending = f".{suffix.lower()}" if dot else ""
        if ending not in SUFFIXES:
            raise InputError(
                f"{bare:.60}: a mesh file ends in {', '.join(SUFFIXES)}; convert it to one of them"
            )
        if size < 1:
            raise InputError(f"{bare:.60}: the file is empty; export the mesh again")
        if size > LARGEST:
            raise InputError(f"{bare:.60}: the file has over {LARGEST // 2**20} MB; simplify the mesh")
        if self._total + size > ALL_LARGEST:
            raise InputError(f"all uploads have over {ALL_LARGEST // 2**20} MB; reload the page")
        if not self._holders:
            raise EnvironmentFailure("the upload cannot be written: the page was closed")
        safe = re.sub(r"[^A-Za-z0-9_-]+", "_", stem).strip("_")[:40] or "object"
        try:
            if self._folder is None:
                self._folder = tempfile.TemporaryDirectory(prefix="preshape-")
            self._count += 1
            self._path = Path(self._folder.name) / str(self._count) / f"{safe}{ending}"
            self._path.parent.mkdir()
            self._path.touch()
        except OSError as error:
            raise EnvironmentFailure(f"the upload cannot be written: {error.strerror or error}") from error
        self._total += size
        self._left = size

    def add(self, content: bytes) -> Path | None:
        """Write the next part of the file; returns its path when it is complete.

        Raises:
            InputError: The part is longer than what is left of the file.
            EnvironmentFailure: The file cannot be written.
        """
        if len(content) > self._left:
            raise InputError(f"{self._path.name}: the browser sent more than it had said; try again")
        try:
            with self._path.open("ab") as file:
                file.write(content)
        except OSError as error:
            raise EnvironmentFailure(f"the upload cannot be written: {error.strerror or error}") from error
        self._left -= len(content)
        return None if self._left else self._path

    def shared(self) -> Uploads:
        """The same uploads for another holder, who closes them too."""
        with self._lock:
            self._holders += 1 if self._holders else 0
        return self

    def close(self) -> None:
        """Give the uploads up; after the last holder they are deleted, and later ones are refused."""
        with self._lock:
            self._holders = max(0, self._holders - 1)
            folder, left = self._folder, self._holders
            if not left:
                self._folder = None
        if folder is not None and not left:
            folder.cleanup()


class Receiver:
    """Takes a browser's uploads in place of viser, which holds whatever comes in memory.

    Args:
        client: The browser.
        uploads: Where the files go.
        arrived: Called with the path of each complete file, on the server's event loop.
        refused: Called with the reason why a file is not taken.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        uploads: Uploads,
        arrived: Callable[[Path], None],
        refused: Callable[[str], None],
    ) -> None:
        from viser import _messages as messages

        self._uploads, self._arrived, self._refused = uploads, arrived, refused
        self._acknowledgement = messages.FileTransferPartAck
        self._wire: Any = client.gui._websock_interface
        self._transfer: str | None = None
        self._size = self._next = self._received = 0
        for kind, handler in (
            (messages.FileTransferStartUpload, self._begin),
            (messages.FileTransferPart, self._take),
        ):
            self._wire.unregister_handler(kind)
            self._wire.register_handler(kind, handler)

    def _begin(self, _client: int, message: Any) -> None:
        self._transfer, self._size = message.transfer_uuid, message.size_bytes
        self._next = self._received = 0
        try:
            self._uploads.begin(message.filename, self._size)
        except PreshapeError as error:
            self._refuse(message, error)

    def _take(self, _client: int, message: Any) -> None:
        if (message.transfer_uuid, message.part_index) != (self._transfer, self._next):
            return  # a part of a refused file
        try:
            path = self._uploads.add(message.content)
        except PreshapeError as error:
            self._refuse(message, error)
            return
        self._next += 1
        self._received += len(message.content)
        self._acknowledge(message, self._received)
        if path is not None:
            self._transfer = None
            self._arrived(path)

    def _refuse(self, message: Any, error: PreshapeError) -> None:
        self._transfer = None
        self._acknowledge(message, self._size)  # the browser takes the file as sent and stops waiting
        self._refused(str(error))

    def _acknowledge(self, message: Any, received: int) -> None:
        self._wire.queue_message(
            self._acknowledgement(
                source_component_uuid=message.source_component_uuid,
                transfer_uuid=message.transfer_uuid,
                transferred_bytes=received,
                total_bytes=self._size,
            )
        )
