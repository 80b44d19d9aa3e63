"""SQLite's errors in the words of this package; no ``sqlite3`` error leaves ``preshape.memory``."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from ..exceptions import EnvironmentFailure, MemoryFileError, PreshapeError

BUSY_SECONDS = 10.0
ELSEWHERE = "choose another file with --memory OTHER"

_BUSY = {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_PROTOCOL}
_DENIED = {
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_AUTH,
}


def primary_code(error: sqlite3.Error) -> int:
    """SQLite's primary result code, 0 where Python gave none."""
    return int(getattr(error, "sqlite_errorcode", None) or 0) & 0xFF


def describe(error: sqlite3.Error, where: str) -> PreshapeError:
    """The error of ours that says the same about the memory at ``where``."""
    code, said = primary_code(error), one_line(error)
    if isinstance(error, sqlite3.ProgrammingError):
        return EnvironmentFailure(f"the memory {where} is closed or belongs to another thread: {said}")
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
            f"the memory {where} cannot be opened or written ({said}); check its permissions or {ELSEWHERE}"
        )
    if code == sqlite3.SQLITE_NOTADB:
        return MemoryFileError(f"{where} is not a memory of preshape (not a SQLite file); {ELSEWHERE}")
    if code in {sqlite3.SQLITE_IOERR, sqlite3.SQLITE_NOMEM, sqlite3.SQLITE_INTERRUPT}:
        return EnvironmentFailure(f"the memory {where} could not be read or written ({said}); try again")
    return MemoryFileError(f"the memory {where} is damaged ({said}); restore a copy or {ELSEWHERE}")


def one_line(error: Exception) -> str:
    """What an error says, which may quote the damaged file, as text that prints in one line."""
    return " ".join("".join(c if c.isprintable() else " " for c in str(error)).split())[:200]


@contextmanager
def translated(where: str) -> Iterator[None]:
    """Turn what SQLite and the file system raise inside into errors of ours.

    Raises:
        MemoryFileError: the file is damaged or not a memory.
        EnvironmentFailure: locked, full, denied or any other fault of the surroundings.
    """
    try:
        yield
    except sqlite3.Error as error:
        raise describe(error, where) from error
    except MemoryError as error:  # SQLite's answer to a record that says it is longer than all memory
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
    """All of what happens inside, or nothing; durable once left without an error.

    The write lock is taken at the start, so that a transaction never fails half-way for having read
    what another process has changed since.
    """
    connection.execute(begin)
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        with suppress(sqlite3.Error):
            connection.execute("ROLLBACK")
        raise
