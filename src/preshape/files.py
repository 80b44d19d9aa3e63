"""Files that are written whole or not at all, and the folder of those that can be made again."""

from __future__ import annotations

import contextlib
import io
import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from .exceptions import EnvironmentFailure


def dumps(document: Any) -> str:
    """JSON text; numbers that are not finite are a fault of ours and raise."""
    return json.dumps(document, allow_nan=False, indent=2)


def write_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Write a file whole or not at all: into a neighbour first, then renamed.

    Args:
        path: the file; its folder is made where it is missing.
        write: writes the content to the path it is given.

    Raises:
        EnvironmentFailure: the folder cannot be made or written, or the disk is full.
    """
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
        os.close(handle)
        temporary = Path(name)
        write(temporary)
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise EnvironmentFailure(f"cannot write {path}: {reason}; choose another folder") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def make_folder(path: Path) -> None:
    """Make a folder that will be written to, and those above it, before long work is done for it.

    Raises:
        EnvironmentFailure: it cannot be made, or not be written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EnvironmentFailure(f"cannot make the folder {path}: {error.strerror}") from error
    if not os.access(path, os.W_OK | os.X_OK):
        raise EnvironmentFailure(f"cannot write to the folder {path}: permission denied")


def write_json(path: Path, document: Any) -> None:
    """Write JSON whole or not at all."""
    write_text(path, dumps(document) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write text whole or not at all."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write bytes whole or not at all; they are on the disk when this returns."""

    def write(target: Path) -> None:
        with target.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())

    write_whole(path, write)


def locked(file: IO[bytes]) -> bool:
    """Take an open file for this process; it is free again when it is closed, however the process ends.

    Returns:
        False where another process has it; True also where the system has no such locks.
    """
    try:
        import fcntl
    except ImportError:
        return True
    try:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without them
        return True
    return True


def cache_folder() -> Path:
    """Where what can be made again is kept: ``PRESHAPE_CACHE``, or the user's cache directory."""
    chosen = os.environ.get("PRESHAPE_CACHE", "")
    if chosen:
        return Path(chosen)
    from platformdirs import user_cache_path

    return user_cache_path("preshape")


def read_arrays(path: Path) -> dict[str, Any]:
    """The arrays of an npz, read into memory, without pickle.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no such file, or a damaged one.
    """
    import numpy as np

    content = io.BytesIO(path.read_bytes())
    try:
        with np.load(content, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except Exception as error:  # a damaged zip raises whatever its damaged bytes happen to mean
        raise ValueError(str(error) or type(error).__name__) from error


def keep_arrays(path: Path, /, **arrays: Any) -> None:
    """Write arrays to a cache as npz, whole or not at all. One that cannot be written is done without."""
    import numpy as np

    def write(target: Path) -> None:
        with target.open("wb") as stream:
            np.savez(stream, **arrays)

    with contextlib.suppress(EnvironmentFailure):
        write_whole(path, write)
