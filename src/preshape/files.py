"""Files that are written whole or not at all, limits of reading, and the cache folder."""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import stat
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from .exceptions import EnvironmentFailure, InputError, shown

if TYPE_CHECKING:
    from numpy.typing import NDArray

MEGABYTE = 2**20
MOST_OF_MESH, MOST_OF_ARRAYS = 1024 * MEGABYTE, 1024 * MEGABYTE
"""Largest file of a mesh or a point cloud, and of arrays [bytes]; larger ones do not fit into memory."""
MOST_OF_JSON, MOST_OF_TOML, MOST_OF_MODEL = 256 * MEGABYTE, MEGABYTE, 64 * MEGABYTE
"""Largest plan or exported memory, hand description, and MJCF or URDF [bytes]; real ones have 1 % of it."""
_LFS = b"version https://git-lfs.github.com/spec/"


def dumps(document: Any) -> str:
    """JSON text.

    Raises:
        ValueError: A number is not finite, which is a defect of this program.
    """
    return json.dumps(document, allow_nan=False, indent=2)


def loads(text: str | bytes, **options: Any) -> Any:
    """The document in a JSON text; one that is nested too deeply is refused like other faults.

    Args:
        text: The text.
        options: Options of ``json.loads``.

    Raises:
        ValueError: The text is not JSON, or is nested too deeply.
    """
    try:
        return json.loads(text, **options)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def read_file(
    path: str | Path, most: int, wanted: str = "file", *, refusal: type[InputError] = InputError
) -> bytes:
    """The content of a regular file of limited size.

    Pipes, devices and sockets are refused, because reading them may never end.

    Args:
        path: The file.
        most: Largest number of bytes.
        wanted: Noun for messages, such as ``mesh file``.
        refusal: The error that refuses a file.

    Raises:
        InputError: The path is a folder or no regular file, the file is too large, or it is the pointer that
            Git LFS leaves in place of a file.
        OSError: The file cannot be read.
        ValueError: The path cannot be that of a file.
    """
    found = os.stat(path)
    mode, size = found.st_mode, found.st_size
    if stat.S_ISDIR(mode):
        raise refusal(f"{path}: this is a folder; name one {wanted} in it")
    if not stat.S_ISREG(mode):
        raise refusal(f"{path}: this is not a regular file but a pipe, device or socket; name a {wanted}")
    # If a pipe has taken the file's place in the meantime, opening it does not wait for a writer.
    content = b""
    if size <= most:
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | _NO_WAIT)) as file:
            content = file.read(most + 1)
    if (size := max(size, len(content))) > most:
        raise refusal(
            f"{path}: {size / MEGABYTE:.0f} MB are too much for a {wanted}, of which at most "
            f"{most // MEGABYTE} MB are read; give a smaller one"
        )
    if content.startswith(_LFS):
        raise refusal(
            f"{path}: this is a Git LFS pointer and not the {wanted} itself; fetch the file with git lfs pull"
        )
    return content


_NO_WAIT = getattr(os, "O_NONBLOCK", 0)


def file_stem(name: str, longest: int = 50) -> str:
    """A file name without its suffix, made from a name that may hold anything.

    Args:
        name: Any text, such as the name of a mesh.
        longest: Largest number of characters, so that a file system takes the name with a suffix.

    >>> file_stem("cup/v 2"), file_stem(".."), file_stem("")
    ('cup_v 2', 'unnamed', 'unnamed')
    """
    safe = "".join(c if c.isalnum() or c in " ._-" else "_" for c in name)
    return safe[:longest].strip(" .") or "unnamed"


def path_of(given: object, name: str) -> Path:
    """A path that a caller gave.

    Args:
        given: Text or a path.
        name: What it is, for the message.

    Raises:
        InputError: It is neither, it is empty, or no file system can have it.
    """
    text = str(given) if isinstance(given, str | Path) else ""
    with contextlib.suppress(UnicodeEncodeError):
        if os.fsencode(text) and "\0" not in text:
            return Path(text)
    raise InputError(f"{name} must be a path, got {shown(given)}")


def file_state(path: str | Path) -> tuple[int, ...] | None:
    """A value that changes whenever a file is written or replaced; ``None`` if there is no such file.

    The first two numbers, device and inode, change only if another file takes its place.
    """
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return None
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def file_place(path: str | Path) -> tuple[int, ...] | None:
    """A value that changes when another file takes the place of this one; ``None`` if there is none."""
    state = file_state(path)
    return None if state is None else state[:2]


_temporaries: set[Path] = set()


@contextlib.contextmanager
def temporary_folder(what: str) -> Iterator[Path]:
    """A folder that exists for the length of a ``with`` block, also if the process is interrupted.

    Args:
        what: What it is for, as a part of its name.

    Raises:
        EnvironmentFailure: There is no place for temporary files.
    """
    try:
        folder = Path(tempfile.mkdtemp(prefix=f"preshape-{what}-"))
    except OSError as error:
        raise EnvironmentFailure(
            f"no temporary folder can be made: {error.strerror}; set TMPDIR to a folder that can be written"
        ) from error
    _temporaries.add(folder)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _temporaries.discard(folder)


def spare_folder(what: str) -> Path:
    """This user's own folder among the temporary files, where the user's cache cannot be written.

    A folder of that name that belongs to somebody else, or that others can write to, is not used; the path is
    then one that cannot exist.

    Args:
        what: What it is for, as a part of its name.
    """
    user = os.getuid() if hasattr(os, "getuid") else None
    folder = Path(tempfile.gettempdir()) / f"preshape-{what}-{'' if user is None else user}"
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        if stat.S_ISDIR(found.st_mode) and user in (None, found.st_uid) and not found.st_mode & 0o022:
            return folder
    return Path(os.devnull) / what


def remove_temporaries() -> None:
    """Remove the temporary files and folders of this process, which is about to end at once."""
    for path in tuple(_temporaries):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def write_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Write a file whole or not at all: a temporary file beside it is written and then renamed.

    Args:
        path: The file; its folder is created if it is missing.
        write: Function that writes the content to the path it is given.

    Raises:
        EnvironmentFailure: The folder cannot be created or written, or the disk is full.
    """
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
        os.close(handle)
        temporary = Path(name)
        _temporaries.add(temporary)
        write(temporary)
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise EnvironmentFailure(f"cannot write {path}: {reason}; choose another folder") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
            _temporaries.discard(temporary)


def make_folder(path: Path) -> None:
    """Create a folder and the folders above it, so that long work does not fail at its end.

    Raises:
        EnvironmentFailure: The folder cannot be created, or cannot be written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EnvironmentFailure(f"cannot create the folder {path}: {error.strerror}") from error
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
    """Lock an open file for this process; closing it, also by the end of the process, releases the lock.

    Returns:
        False if another process holds the lock; True also on a system without such locks.
    """
    try:
        import fcntl
    except ImportError:
        return True
    try:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True


def cache_folder() -> Path:
    """Folder of cached results: ``PRESHAPE_CACHE``, or the user's cache directory."""
    chosen = os.environ.get("PRESHAPE_CACHE", "")
    if chosen:
        return Path(chosen)
    from platformdirs import user_cache_path

    return user_cache_path("preshape")


def read_arrays(path: Path) -> dict[str, Any]:
    """The arrays of an npz file in a cache; see :func:`arrays_in`.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file is not such an npz file, is damaged, or is no regular file.
    """
    try:
        content = read_file(path, MOST_OF_ARRAYS)
    except InputError as error:
        raise ValueError(str(error)) from error
    return arrays_in(content)


def arrays_in(content: bytes) -> dict[str, Any]:
    """The arrays of an npz file; pickled content is refused.

    Raises:
        ValueError: The content is not that of an npz file, is damaged, or unpacks to more than
            ``MOST_OF_ARRAYS``.
    """
    import numpy as np

    try:
        with warnings.catch_warnings(), np.load(io.BytesIO(content), allow_pickle=False) as stored:
            warnings.simplefilter("ignore")  # of headers that Python 2 wrote
            size = sum(item.file_size for item in stored.zip.infolist())
            if size > MOST_OF_ARRAYS:
                raise ValueError(f"it unpacks to {size / MEGABYTE:.0f} MB, over {MOST_OF_ARRAYS // MEGABYTE}")
            return {name: stored[name] for name in stored.files}
    except Exception as error:  # a damaged zip file can raise any exception
        raise ValueError(str(error) or type(error).__name__) from error


def array_in(content: bytes) -> NDArray[Any]:
    """The array of an npy file; pickled content is refused.

    Raises:
        ValueError: The content is not that of an npy file, or is damaged.
    """
    import numpy as np

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of headers that Python 2 wrote
            found = np.load(io.BytesIO(content), allow_pickle=False)
    except Exception as error:  # a damaged header can raise any exception
        raise ValueError(str(error) or type(error).__name__) from error
    if not isinstance(found, np.ndarray):
        raise ValueError("it holds several arrays")
    return found


def write_arrays(path: Path, /, **arrays: Any) -> None:
    """Write arrays as npz, whole or not at all.

    Raises:
        EnvironmentFailure: The file cannot be written.
    """
    import numpy as np

    def write(target: Path) -> None:
        with target.open("wb") as stream:
            np.savez(stream, **arrays)

    write_whole(path, write)


def keep_arrays(path: Path, /, **arrays: Any) -> bool:
    """Write arrays to a cache as npz, whole or not at all.

    Returns:
        Whether they were written; without a usable cache they are not.
    """
    try:
        write_arrays(path, **arrays)
    except EnvironmentFailure:
        return False
    return True
