"""Converts SQLite's errors to errors of this package; no ``sqlite3`` error leaves ``preshape.memory``."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from ..exceptions import EnvironmentFailure, MemoryFileError, PreshapeError

BUSY_SECONDS = 10.0
"""Longest wait for a lock of another process [s]."""
ELSEWHERE = "choose another file with --memory OTHER"

_BUSY = {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_PROTOCOL}
_DENIED = {
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_AUTH,
}


def primary_code(error: sqlite3.Error) -> int:
    """SQLite's primary result code; 0 if Python reports none."""
    return int(getattr(error, "sqlite_errorcode", None) or 0) & 0xFF


def describe(error: sqlite3.Error, where: str) -> PreshapeError:
    """The error of this package that corresponds to an SQLite error of the memory at ``where``."""
    code, message = primary_code(error), one_line(error)
    if isinstance(error, sqlite3.ProgrammingError):
        return EnvironmentFailure(f"the memory {where} is closed or belongs to another thread: {message}")
    if code in _BUSY:
        return EnvironmentFailure(
            f"the memory {where} was locked by another process for over {BUSY_SECONDS:.0f} s; try again"
        )
    if code == sqlite3.SQLITE_FULL:
        return EnvironmentFailure(
            f"the disk is full and nothing was stored in the memory {where}; free some space or {ELSEWHERE}"
        )
    if code in _DENIED:
        return EnvironmentFailure(
            f"the memory {where} cannot be opened or written ({message});"
            f" check its permissions or {ELSEWHERE}"
        )
    if code == sqlite3.SQLITE_NOTADB:
        return MemoryFileError(f"{where} is not a memory of preshape (not a SQLite file); {ELSEWHERE}")
    if code in {sqlite3.SQLITE_IOERR, sqlite3.SQLITE_NOMEM, sqlite3.SQLITE_INTERRUPT}:
        return EnvironmentFailure(f"the memory {where} could not be read or written ({message}); try again")
    return MemoryFileError(f"the memory {where} is damaged ({message}); restore a copy or {ELSEWHERE}")


def one_line(error: Exception) -> str:
    """An error's message as one printable line; the message may quote bytes of a damaged file."""
    return " ".join("".join(c if c.isprintable() else " " for c in str(error)).split())[:200]


@contextmanager
def translated(where: str) -> Iterator[None]:
    """Raise errors of this package in place of those of SQLite and the file system.

    Raises:
        MemoryFileError: The file is damaged or not a memory.
        EnvironmentFailure: The file is locked, the disk is full, permission is denied, or similar.
    """
    try:
        yield
    except sqlite3.Error as error:
        raise describe(error, where) from error
    except MemoryError as error:  # from SQLite, where a damaged record claims an impossible length
        raise MemoryFileError(
            f"the memory {where} is damaged (a record of no possible length); restore a copy or {ELSEWHERE}"
        ) from error
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise EnvironmentFailure(
            f"the memory {where} cannot be used ({reason}); check the path or {ELSEWHERE}"
        ) from error


@contextmanager
def transaction(connection: sqlite3.Connection, begin: str = "BEGIN IMMEDIATE") -> Iterator[None]:
    """Execute the whole block or nothing of it; the changes are on disk when the block ends without an error.

    The write lock is taken at the start. Otherwise a transaction could fail half-way, because another process
    changed what this one had read.
    """
    connection.execute(begin)
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        with suppress(sqlite3.Error):
            connection.execute("ROLLBACK")
        raise
