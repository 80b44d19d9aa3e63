"""The tables, their versions, and how a file is opened without damage to it.

A new file is created in version 1 and migrated by ``MIGRATIONS``, so that new and migrated files are alike.

======= ==================================================================================
version what changed
======= ==================================================================================
1       experiences and weights
2       surface area [m²] and volume [m³] of the object, used by recognition
3       the object's shape descriptor; the grip of a real hand, its quality, its outcome in physics
4       the scene of the lesson: table and boxes, empty for free space
5       the unit of length of the net wrench, ``U`` in older lessons; virtual grasps of these keep plane,
        thumb side, approach value and fingers, while wrench and match are void until the object is met
6       hash of the real hand's model, empty in older lessons
======= ==================================================================================

A file is inspected before it is opened for writing. A file that is not a memory, or that a newer version
wrote, is refused and not changed. The first transaction of a new file uses a rollback journal; only then does
the file switch to write-ahead logging. Its header therefore names this application from the first committed
byte.

Columns of numbers have no declared type, because a REAL column would lose the sign of -0.0.

A file may come from anybody. So its schema must be exactly that of its version: a trigger, a view, a virtual
table, a generated column or a constraint would be code of somebody else, run at the next lesson.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable
from contextlib import closing, suppress
from functools import cache
from os import fspath, getpid
from pathlib import Path

from ..exceptions import EnvironmentFailure, MemoryFileError
from ..types import OLD_UNIT_NAME
from .failures import BUSY_SECONDS, ELSEWHERE, primary_code, transaction
from .records import OLD_SCENE

APPLICATION_ID = 0x70726573  # "pres"
SCHEMA_VERSION = 6

_VERSION_1 = (
    """CREATE TABLE experiences (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    hand TEXT NOT NULL, kind TEXT NOT NULL, object_name TEXT NOT NULL,
    extent_x NOT NULL, extent_y NOT NULL, extent_z NOT NULL,
    vertices INTEGER NOT NULL, vertex_normals INTEGER NOT NULL,
    faces INTEGER NOT NULL, triangles INTEGER NOT NULL,
    task_tx NOT NULL, task_ty NOT NULL, task_tz NOT NULL,
    task_rx NOT NULL, task_ry NOT NULL, task_rz NOT NULL,
    plane INTEGER NOT NULL, flip INTEGER NOT NULL, approach_value NOT NULL,
    approach_set INTEGER NOT NULL, fingers INTEGER NOT NULL,
    wrench_fx NOT NULL, wrench_fy NOT NULL, wrench_fz NOT NULL,
    wrench_mx NOT NULL, wrench_my NOT NULL, wrench_mz NOT NULL,
    match NOT NULL, created TEXT NOT NULL)""",
    "CREATE INDEX experiences_by_hand ON experiences (hand, kind)",
    """CREATE TABLE weights (
    hand TEXT PRIMARY KEY,
    inputs INTEGER NOT NULL, hidden INTEGER NOT NULL, outputs INTEGER NOT NULL,
    w1 BLOB NOT NULL, b1 BLOB NOT NULL, w2 BLOB NOT NULL, b2 BLOB NOT NULL,
    mean_square_error NOT NULL, trained_on INTEGER NOT NULL, epochs INTEGER NOT NULL)""",
)


def _add_area_and_volume(connection: sqlite3.Connection) -> None:
    """Version 1 to 2: area [m²] and volume [m³]; old rows get those of the bounding box.

    Version 1 did not store them, and the mesh is not available. The values of the bounding box are exact for
    a box, and upper bounds for any other convex object.
    """
    connection.execute("ALTER TABLE experiences ADD COLUMN area NOT NULL DEFAULT 0")
    connection.execute("ALTER TABLE experiences ADD COLUMN volume NOT NULL DEFAULT 0")
    connection.execute(
        "UPDATE experiences SET volume = extent_x * extent_y * extent_z,"
        " area = 2 * (extent_x * extent_y + extent_y * extent_z + extent_z * extent_x)"
    )


def _add_shape_and_grip(connection: sqlite3.Connection) -> None:
    """Version 2 to 3: shape, grip, quality and outcome; an unknown value is NULL, as in every old row."""
    for name in ("shape", "grip", "quality", "outcome"):
        connection.execute(f"ALTER TABLE experiences ADD COLUMN {name}")


def _add_scene(connection: sqlite3.Connection) -> None:
    """Version 3 to 4: the scene; older lessons were learnt in free space, those of real hands at 0.1 kg."""
    connection.execute("ALTER TABLE experiences ADD COLUMN scene TEXT NOT NULL DEFAULT ''")
    connection.execute(
        "UPDATE experiences SET scene = ? WHERE grip IS NOT NULL AND kind <> 'seed'", (OLD_SCENE,)
    )


def _add_length_unit(connection: sqlite3.Connection) -> None:
    """Version 4 to 5: the unit of length, 4U since then.

    The first lesson with virtual grasps, whose cube had half the paper's size, and all weights are deleted,
    because both are made again when the hand is used next.
    """
    connection.execute(
        f"ALTER TABLE experiences ADD COLUMN length_unit TEXT NOT NULL DEFAULT '{OLD_UNIT_NAME}'"
    )
    connection.execute("DELETE FROM experiences WHERE kind = 'seed' AND grip IS NULL")
    connection.execute("DELETE FROM weights")


def _add_model(connection: sqlite3.Connection) -> None:
    """Version 5 to 6: the hash of the hand's model; nobody knows with which model a hand learnt before."""
    connection.execute("ALTER TABLE experiences ADD COLUMN model TEXT NOT NULL DEFAULT ''")


_SMALLEST_DATABASE = 512  # bytes
_UNSETTLED = {sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_CORRUPT}

MIGRATIONS: dict[int, Callable[[sqlite3.Connection], None]] = {
    1: _add_area_and_volume,
    2: _add_shape_and_grip,
    3: _add_scene,
    4: _add_length_unit,
    5: _add_model,
}
"""For each version the migration to the next one, which runs inside a transaction."""


LONGEST_CELL = 16_000_000
"""Largest cell or row that is read [bytes]; a damaged or hostile file could claim up to 1 GB."""


def connect(uri: str) -> sqlite3.Connection:
    """A connection without implicit transactions that waits ``BUSY_SECONDS`` for locks.

    It trusts neither the schema nor the pages of the file, as SQLite advises for files of others.
    """
    connection = sqlite3.connect(uri, uri=True, timeout=BUSY_SECONDS, isolation_level=None)
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST_CELL)
    # Text of other bytes is read, for the checks to refuse the row; it is no fault of the file.
    connection.text_factory = lambda content: content.decode("utf-8", "surrogateescape")
    connection.execute("PRAGMA trusted_schema = OFF")
    connection.execute("PRAGMA cell_size_check = ON")
    return connection


def open_writable(path: Path) -> sqlite3.Connection:
    """Open the memory at ``path``; it is created or migrated if necessary.

    Raises:
        MemoryFileError: The file is not a memory, damaged, or of a newer version; it is not changed.
        sqlite3.Error, OSError: Other errors; :func:`~preshape.memory.failures.translated` converts them.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    _inspect(path)
    connection = connect(f"{path.as_uri()}?mode=rwc")
    try:
        connection.execute("PRAGMA synchronous = FULL")
        if _snapshot_version(connection, path) < SCHEMA_VERSION:
            with transaction(connection):
                _migrate(connection, path)
        _write_ahead(connection)
    except BaseException:
        connection.close()
        raise
    return connection


def open_readable(path: Path) -> sqlite3.Connection:
    """Open the memory at ``path`` for reading; an older version is migrated in a copy in main memory.

    On a read-only file system, SQLite cannot create the files that it needs beside a memory. The file is then
    read as immutable, unless a write-ahead log beside it has further changes.

    Raises:
        MemoryFileError: The file is not a memory, damaged, or of a newer version.
        EnvironmentFailure: The log beside the file can be read only with write permission.
        sqlite3.Error, OSError: Other errors; :func:`~preshape.memory.failures.translated` converts them.
    """
    _inspect(path)
    try:
        connection = _readable(path, "mode=ro")
    except sqlite3.OperationalError as error:
        if primary_code(error) not in {sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY}:
            raise
        if _has_log(path):
            raise EnvironmentFailure(
                f"the memory {path} has a log beside it that cannot be read without write permission;"
                f" make {path.parent} writable once or {ELSEWHERE}"
            ) from error
        connection = _readable(path, "mode=ro&immutable=1")
    connection.execute("PRAGMA query_only = ON")
    return connection


def _readable(path: Path, way: str) -> sqlite3.Connection:
    connection = connect(f"{path.as_uri()}?{way}")
    try:
        if _snapshot_version(connection, path) == SCHEMA_VERSION:
            return connection
        copy = connect("file::memory:")
        _copy(connection, copy)
        with transaction(copy):
            _migrate(copy, None)
    except BaseException:
        connection.close()
        raise
    close_readable(connection, path)
    return copy


def close_readable(connection: sqlite3.Connection, path: Path) -> None:
    """Close a connection for reading without leaving files beside the memory.

    SQLite creates an empty log to read a memory, and only a connection that may write can remove it again.
    """
    connection.close()
    if Path(f"{fspath(path)}-wal").exists() and not _has_log(path):
        with suppress(sqlite3.Error), closing(connect(f"{path.as_uri()}?mode=rw")) as writing:
            writing.execute("PRAGMA user_version").fetchone()


def open_transient() -> sqlite3.Connection:
    """A memory in main memory; it is lost when the connection is closed."""
    connection = connect("file::memory:")
    with transaction(connection):
        _migrate(connection, None)
    return connection


def _inspect(path: Path) -> None:
    """Refuse a file that is not a memory before anything could change it.

    SQLite reads the file as immutable, without a lock and without files beside it. The file must not be
    opened with ``open`` here: closing it would release the locks that this process already holds on it.

    Raises:
        MemoryFileError: The file is not a memory, or of a newer version.
        EnvironmentFailure: It is not a regular file.
    """
    if not path.exists() or (path.is_file() and path.stat().st_size == 0):
        return
    if not path.is_file():
        raise EnvironmentFailure(f"the memory {path} is not a regular file; {ELSEWHERE}")
    if path.stat().st_size < _SMALLEST_DATABASE:  # to SQLite, such a file is an empty database
        raise MemoryFileError(f"{path} is not a memory of preshape (not a SQLite file); {ELSEWHERE}")
    for way in ("mode=ro&immutable=1", "mode=ro"):
        try:
            with closing(connect(f"{path.as_uri()}?{way}")) as connection:
                if _snapshot_version(connection, path) or not _has_log(path):
                    return
        except sqlite3.DatabaseError as error:
            # Another process may be creating the file or checkpointing its log: read again, with locks.
            if primary_code(error) not in _UNSETTLED or way == "mode=ro":
                raise


def _snapshot_version(connection: sqlite3.Connection, path: Path) -> int:
    """:func:`_version` in its own transaction, because another process may be creating the file."""
    with transaction(connection, "BEGIN"):
        return _version(connection, path)


def _version(connection: sqlite3.Connection, path: Path) -> int:
    """The schema version, 0 for an empty database; called inside a transaction, because it reads twice.

    Raises:
        MemoryFileError: The file is of another application or of a newer version, or has a strange schema.
    """
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if (application, version) == (0, 0):
        (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        if tables == 0:
            return 0
    if application != APPLICATION_ID or version < 1:
        raise _foreign(path)
    if version > SCHEMA_VERSION:
        raise MemoryFileError(
            f"the memory {path} has version {version}, newer than the {SCHEMA_VERSION} known here;"
            f" upgrade preshape or {ELSEWHERE}"
        )
    _refuse_strange_schema(connection, path, int(version))
    return int(version)


_Item = tuple[str, str, str, str]


def _schema_of(connection: sqlite3.Connection) -> set[_Item]:
    """All that a database defines: type, name, table, and definition without spaces, quotes and case."""
    return {
        (*map(str, names), "".join(str(sql).lower().translate(_NO_QUOTES).split()))  # type: ignore[misc]
        for *names, sql in connection.execute("SELECT type, name, tbl_name, sql FROM sqlite_master")
    }


_NO_QUOTES = str.maketrans("", "", '"`[]')
_STATISTICS = ("sqlite_stat1", "sqlite_stat4")
"""Tables that ANALYZE makes; SQLite allows nobody else to use names with this beginning."""


@cache
def _own_schema(version: int) -> frozenset[_Item]:
    """All that a memory of a version defines."""
    with closing(sqlite3.connect(":memory:")) as connection:
        for statement in _VERSION_1:
            connection.execute(statement)
        for step in range(1, version):
            MIGRATIONS[step](connection)
        return frozenset(_schema_of(connection))


def _refuse_strange_schema(connection: sqlite3.Connection, path: Path, version: int) -> None:
    """Refuse a memory that defines more than its version does, or defines it otherwise.

    Raises:
        MemoryFileError: The message names what is strange or missing.
    """
    there, own = _schema_of(connection), _own_schema(version)
    for kind, name, table, _ in sorted(there - own):
        if name in _STATISTICS:
            continue
        what = f"{kind} {name!r:.60}" + ("" if name == table else f" on {table!r:.60}")
        changed = any((kind, name) == item[:2] for item in own)
        raise MemoryFileError(
            f"the memory {path} has {'another' if changed else 'a'} {what}"
            f" {'than' if changed else 'that'} preshape {'makes' if changed else 'did not make'};"
            f" it is not used, because it could run somebody else's code: restore a copy or {ELSEWHERE}"
        )
    for kind, name, *_ in sorted(own - there):
        raise MemoryFileError(
            f"the memory {path} is damaged (it lacks the {kind} {name!r}); restore a copy or {ELSEWHERE}"
        )


def _foreign(path: Path) -> MemoryFileError:
    return MemoryFileError(
        f"{path} is not a memory of preshape (a SQLite file of another program); {ELSEWHERE}"
    )


def _has_log(path: Path) -> bool:
    log = Path(f"{fspath(path)}-wal")
    return log.exists() and log.stat().st_size > 0


def _migrate(connection: sqlite3.Connection, path: Path | None) -> None:
    """Create or migrate the tables inside the open transaction, unless another process already has.

    Args:
        connection: A connection inside a transaction.
        path: Path of the file, for the backup copy beside it; None for main memory.
    """
    version = _version(connection, path or Path(":memory:"))
    if version == 0:
        for statement in _VERSION_1:
            connection.execute(statement)
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        version = 1
    elif version < SCHEMA_VERSION and path is not None:
        _back_up(path, version)
    for step in range(version, SCHEMA_VERSION):
        MIGRATIONS[step](connection)
    connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")


def _back_up(path: Path, version: int) -> Path:
    """Copy the database to ``NAME.v1-backup`` (or ``NAME.v1-backup-2`` …) before its migration.

    The caller holds the write lock, so the copy equals the database that is migrated. A connection cannot be
    copied inside its own write transaction; therefore a second connection reads.
    """
    target = path.with_name(f"{path.name}.v{version}-backup")
    count = 1
    while target.exists():
        count += 1
        target = path.with_name(f"{path.name}.v{version}-backup-{count}")
    unfinished = path.with_name(f"{path.name}.{getpid()}.unfinished")
    try:
        with (
            closing(connect(f"{path.as_uri()}?mode=ro")) as source,
            closing(connect(f"{unfinished.as_uri()}?mode=rwc")) as copy,
        ):
            _copy(source, copy)
        unfinished.rename(target)
    finally:
        with suppress(OSError):
            unfinished.unlink()
    return target


def _copy(source: sqlite3.Connection, target: sqlite3.Connection) -> None:
    """Copy a whole database; retry while it is locked, up to ``BUSY_SECONDS`` (Python has no limit)."""
    deadline = time.monotonic() + BUSY_SECONDS

    def progress(status: int, remaining: int, total: int) -> None:
        if status != sqlite3.SQLITE_DONE and time.monotonic() > deadline:
            raise EnvironmentFailure(
                f"a memory of an older version was locked for over {BUSY_SECONDS:.0f} s and could not be"
                " copied before its migration; try again"
            )

    source.backup(target, progress=progress, sleep=0.05)


def _write_ahead(connection: sqlite3.Connection) -> None:
    """Switch the file to write-ahead logging; SQLite does not wait for this lock by itself."""
    deadline = time.monotonic() + BUSY_SECONDS
    while True:
        try:
            connection.execute("PRAGMA journal_mode = WAL").fetchone()
        except sqlite3.OperationalError as error:
            if primary_code(error) != sqlite3.SQLITE_BUSY or time.monotonic() > deadline:
                raise
            time.sleep(0.01)
        else:
            return
