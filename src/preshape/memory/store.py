"""The memory's interface; each change is one transaction."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

from ..exceptions import EnvironmentFailure, InputError, MemoryFileError, shown
from ..files import file_place
from ..types import Experience, NetworkWeights
from . import bulk, records, schema, summary, transfer
from .failures import ELSEWHERE, transaction, translated
from .limits import usable
from .summary import MemoryStatistics, ObjectSummary

_COLUMNS = ", ".join(records.EXPERIENCE_COLUMNS)
_READ = ", ".join(
    f"CASE WHEN length(CAST({name} AS BLOB)) <= {most} THEN {name}"
    f" ELSE CAST(substr(CAST({name} AS BLOB), 1, {most + 1}) AS TEXT) END"
    if (most := records.LONGEST_CELLS.get(name))
    else name
    for name in records.EXPERIENCE_COLUMNS
)
"""Columns as they are read: of a text or array that is too long, only so much that the checks notice it."""
_INSERT = f"INSERT INTO experiences ({_COLUMNS}) VALUES ({', '.join('?' * len(records.EXPERIENCE_COLUMNS))})"
_REPLACE = (
    f"UPDATE experiences SET {', '.join(f'{name} = ?' for name in records.EXPERIENCE_COLUMNS)}"
    f" WHERE {' AND '.join(f'{name} IS ?' for name in records.EXPERIENCE_COLUMNS)}"
)
_WEIGHT_COLUMNS = ", ".join(records.WEIGHT_COLUMNS)
_UPSERT = (
    f"INSERT INTO weights ({_WEIGHT_COLUMNS}) VALUES ({', '.join('?' * len(records.WEIGHT_COLUMNS))})"
    " ON CONFLICT (hand) DO UPDATE SET "
    + ", ".join(f"{name} = excluded.{name}" for name in records.WEIGHT_COLUMNS[1:])
    + " WHERE excluded.trained_on >= weights.trained_on"
)


def default_path() -> Path:
    """Default path of the memory: ``PRESHAPE_MEMORY``, or a file in the user's data directory."""
    chosen = os.environ.get("PRESHAPE_MEMORY")
    if chosen:
        return Path(chosen)
    import platformdirs

    return Path(platformdirs.user_data_dir("preshape", appauthor=False)) / "memory.sqlite"


class Memory:
    """Experiences and weights on disk; a context manager, to be used by one thread.

    Open it with :meth:`open`. Every method may raise ``EnvironmentFailure`` (file locked for over 10 s, disk
    full, permission denied, memory closed) and ``MemoryFileError`` (file damaged).

    Attributes:
        where: Path of the file as text, or ``:memory:``.
        read_only: Whether changes are refused.
        skipped: The number of each experience that was left out when reading, with the reason; see
            :mod:`.limits`.
    """

    def __init__(self, connection: sqlite3.Connection, where: str, *, read_only: bool) -> None:
        self._connection = connection
        self.where = where
        self.read_only = read_only
        self.skipped: dict[int, str] = {}
        self._place = file_place(where)

    @classmethod
    def open(cls, path: Path | str | None = None, *, read_only: bool = False) -> Self:
        """Open a memory; a missing file and its directories are created.

        A file without write permission is opened read-only; ``read_only`` of the result is then True.

        Args:
            path: The file; ``":memory:"`` for a memory that is lost when closed; None for
                :func:`default_path`.
            read_only: Whether to change nothing on disk. If the file does not exist, the memory is empty and
                lost when closed. An older version is migrated in a copy.

        Raises:
            MemoryFileError: The file is not a memory, damaged, or of a newer version; it is not changed.
            EnvironmentFailure: It cannot be opened or created.
        """
        where = str(default_path() if path is None else path)
        if not isinstance(path, str | Path | None) or not where or "\0" in where:
            raise MemoryFileError(f"a memory needs the path of a file, got {shown(path)}; {ELSEWHERE}")
        with translated(where):
            if where == ":memory:":
                return cls(schema.open_transient(), where, read_only=read_only)
            file = _absolute(where)
            if file.exists() and not (os.access(file, os.W_OK) and os.access(file.parent, os.W_OK)):
                read_only = True
            if not read_only:
                return cls(schema.open_writable(file), str(file), read_only=False)
            if not file.exists() or (file.is_file() and file.stat().st_size == 0):
                return cls(schema.open_transient(), str(file), read_only=True)
            return cls(schema.open_readable(file), str(file), read_only=True)

    def close(self) -> None:
        """Close the memory; may be called twice. The last process to close writes the log into the file.

        If another file has taken the place of the memory's file, SQLite would leave the log beside that file,
        which would then be read with it. So the log is first written into the file that it belongs to.
        """
        with translated(self.where):
            if not self.read_only and file_place(self.where) != self._place:
                with suppress(sqlite3.Error):
                    self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            if self.read_only and self.where != ":memory:":
                schema.close_readable(self._connection, Path(self.where))
            else:
                self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def add(
        self,
        experiences: Sequence[Experience],
        weights: NetworkWeights | None = None,
        *,
        instead_of: NetworkWeights | None = None,
        first: bool = False,
    ) -> tuple[int, ...]:
        """Store experiences, and the weights trained with them, in one transaction.

        Args:
            experiences: Experiences; an empty ``created`` is set to the current time.
            weights: Weights for the hand of these experiences.
            instead_of: The weights that they replace; see :meth:`save_weights`.
            first: Whether this is a first lesson. If this model of the hand has one already, because another
                process was faster, nothing is stored.

        Returns:
            Number of each experience in the memory; numbers are never reused. On return the experiences are
            on disk. Empty if there was a first lesson already.

        Raises:
            InputError: An experience is out of range, or weights are given and the experiences are not of one
                hand.
        """
        now = datetime.now(UTC).isoformat(timespec="microseconds")
        rows = [records.experience_row(experience, now) for experience in experiences]
        hands = {experience.hand for experience in experiences}
        trained = None
        if weights is not None:
            if len(hands) != 1:
                raise InputError(
                    f"weights need experiences of one hand, got {len(hands)} hands; use save_weights"
                )
            trained = records.weights_row(hands.pop(), weights)
        with self._writing():
            if first and self._has_first_lesson({(e.hand, e.model) for e in experiences}):
                return ()
            numbers = tuple(self._insert(rows))
            if trained is not None:
                self._replace_weights(trained, instead_of)
        return numbers

    def replace(
        self, renewed: Sequence[tuple[Experience, Experience]], weights: NetworkWeights | None = None
    ) -> int:
        """Put a new experience in the place of each stored one, in one transaction.

        Args:
            renewed: Pairs of a stored experience, as it was read, and the one that replaces it. A pair whose
                first is no longer stored is left out.
            weights: Weights for the hand of these experiences; see :meth:`save_weights`.

        Returns:
            Number of experiences replaced.

        Raises:
            InputError: An experience is out of range.
        """
        pairs = [
            (records.experience_row(new, old.created), records.experience_row(old, old.created))
            for old, new in renewed
        ]
        trained = [records.weights_row(old.hand, weights) for old, _ in renewed[:1] if weights is not None]
        with self._writing():
            done = sum(self._connection.execute(_REPLACE, (*new, *old)).rowcount for new, old in pairs)
            for row in trained:
                self._replace_weights(row)
        return done

    def experiences(
        self, hand: str | None = None, kinds: Collection[str] | None = None, *, gripped: bool = False
    ) -> tuple[Experience, ...]:
        """The experiences in the order in which they were stored.

        A malformed one, or one with numbers that no object or hand can have, is left out and noted in
        ``skipped``, so that it does not disable the others.

        Args:
            hand: Only those of this hand.
            kinds: Only those of these kinds; see ``KINDS``.
            gripped: Only those with the grip of a real hand.

        Raises:
            InputError: A kind does not exist.
        """
        query, values = f"SELECT id, {_READ} FROM experiences WHERE 1", list[str]()
        if hand is not None:
            # The index gives the numbers; read through it directly, whole records would have to be sorted.
            query, values = f"{query} AND id IN (SELECT id FROM experiences WHERE hand = ?)", [hand]
        if kinds is not None:
            wanted = [kinds] if isinstance(kinds, str) else list(kinds)
            for kind in wanted:
                if kind not in records.KINDS:
                    raise InputError(f"no kind {shown(kind)}; known: {', '.join(records.KINDS)}")
            query, values = f"{query} AND kind IN ({', '.join('?' * len(wanted))})", values + wanted
        if gripped:
            query = f"{query} AND grip IS NOT NULL"
        found: list[Experience] = []
        with translated(self.where):
            for rows in self._blocks(query, values):
                block, absurd = bulk.experiences(rows, records.experience_from_row)
                found += block
                self.skipped |= absurd
        return tuple(found)

    def _blocks(self, query: str, values: Sequence[str]) -> Iterator[list[records.Row]]:
        """The rows of a query, many at a time; one with a cell that SQLite may not read is skipped."""
        ordered, last = f"{query} AND id > ? ORDER BY id", -(2**63)
        try:
            with closing(self._connection.execute(ordered, (*values, last))) as cursor:
                while rows := cursor.fetchmany(bulk.BLOCK):
                    yield rows
                    last = rows[-1][0]
        except sqlite3.DataError:  # over LONGEST_CELL: that row is found one by one
            for (number,) in self._connection.execute(
                "SELECT id FROM experiences WHERE id > ?", (last,)
            ).fetchall():
                try:
                    rows = self._connection.execute(f"{query} AND id = ?", (*values, number)).fetchall()
                except sqlite3.DataError:
                    self.skipped[number] = f"a cell is larger than {schema.LONGEST_CELL} bytes"
                    continue
                if rows:
                    yield rows

    @property
    def remark(self) -> str:
        """One sentence about the experiences that were skipped; empty if all can be used."""
        if not self.skipped:
            return ""
        number, reason = next(iter(self.skipped.items()))
        more = f" (and {len(self.skipped) - 1} more)" if len(self.skipped) > 1 else ""
        return (
            f"the memory {self.where} has a lesson that is skipped, because it is malformed or its numbers"
            f" cannot be real: experience {number}: {reason}{more}; memory export leaves it out"
        )

    def state(self) -> tuple[int, int]:
        """A value that changes whenever this or another process changes the memory."""
        with translated(self.where):
            version = int(self._connection.execute("PRAGMA data_version").fetchone()[0])
        return version, self._connection.total_changes

    def count(self, hand: str | None = None) -> int:
        """Number of experiences, of all hands or of one."""
        with translated(self.where):
            query = "SELECT count(*) FROM experiences WHERE ?1 IS NULL OR hand = ?1"
            return int(self._connection.execute(query, (hand,)).fetchone()[0])

    def weights(self, hand: str) -> NetworkWeights | None:
        """The network weights of a hand; None without any, or if they are malformed."""
        with translated(self.where):
            query = f"SELECT {_WEIGHT_COLUMNS} FROM weights WHERE hand = ?"
            row = self._connection.execute(query, (hand,)).fetchone()
        return None if row is None else _weights_in(tuple(row))

    def save_weights(
        self, hand: str, weights: NetworkWeights, *, instead_of: NetworkWeights | None = None
    ) -> bool:
        """Store a hand's weights, unless the stored ones were trained on more samples.

        This protects the weights of another process that has learnt more in the meantime.

        Args:
            hand: Name of the hand.
            weights: The weights.
            instead_of: The weights that were read. If they are still stored, they are replaced even if they
                were trained on more samples, some of which no longer count.

        Returns:
            Whether these weights are now stored.

        Raises:
            InputError: The layers do not fit together, or a number is not finite.
        """
        row = records.weights_row(hand, weights)
        with self._writing():
            return self._replace_weights(row, instead_of)

    def reset(self, hand: str | None = None) -> int:
        """Delete everything, or everything of one hand; returns the number of experiences deleted."""
        where = "WHERE ?1 IS NULL OR hand = ?1"
        with self._writing():
            self._connection.execute(f"DELETE FROM weights {where}", (hand,))
            return self._connection.execute(f"DELETE FROM experiences {where}", (hand,)).rowcount

    def objects(self, hand: str | None = None) -> tuple[ObjectSummary, ...]:
        """One summary for each object, sorted by name, of all hands or of one, without skipped lessons."""
        return summary.objects(self.experiences(hand))

    def statistics(self) -> MemoryStatistics:
        """Counts and sizes, all taken at the same moment; skipped lessons do not count."""
        with translated(self.where), transaction(self._connection, "BEGIN"):
            return summary.statistics(self._connection, self.where, self.experiences())

    def export(self, path: Path | str) -> int:
        """Write everything to one JSON document (see :mod:`.transfer`), whole or not at all.

        Experiences and weights that are malformed or outside the limits (:mod:`.limits`) are left out.

        Returns:
            Number of experiences written.

        Raises:
            InputError: ``path`` is the memory itself.
            EnvironmentFailure: The file cannot be written.
        """
        target = Path(path)
        with translated(str(target)):
            if any(target.exists() and target.samefile(own) for own in self._own_files()):
                raise InputError(f"{target} is the memory itself; export to another file")
        with translated(self.where), transaction(self._connection, "BEGIN"):
            experiences = self.experiences()
            rows = self._connection.execute(f"SELECT {_WEIGHT_COLUMNS} FROM weights ORDER BY hand").fetchall()
        weights = [(row[0], found) for row in rows if (found := _weights_in(tuple(row))) is not None]
        transfer.write_document(target, experiences, [pair for pair in weights if usable(pair[1])])
        return len(experiences)

    def import_(self, path: Path | str) -> int:
        """Add the content of an exported document (:meth:`export`) in one transaction; all of it is checked.

        Experiences that the memory already has, with the same time, are skipped. Weights are stored by the
        rule of :meth:`save_weights`.

        Returns:
            Number of experiences added.

        Raises:
            MemoryFileError: The file is not such a document, or of a newer format; nothing was added.
            EnvironmentFailure: It cannot be read.
        """
        experiences, weights = transfer.read_document(Path(path))
        rows = [records.experience_row(experience, experience.created) for experience in experiences]
        with self._writing():
            blocks = self._blocks(f"SELECT id, {_READ} FROM experiences WHERE 1", ())
            present = {row[1:] for block in blocks for row in block}
            fresh = [row for row in dict.fromkeys(rows) if row not in present]
            added = len(list(self._insert(fresh)))
            for hand, content in weights:
                self._replace_weights(records.weights_row(hand, content))
        return added

    @contextmanager
    def _writing(self) -> Iterator[None]:
        if self.read_only:
            raise EnvironmentFailure(
                f"the memory {self.where} is open for reading only; check its permissions or {ELSEWHERE}"
            )
        with translated(self.where), transaction(self._connection):
            yield

    def _has_first_lesson(self, hands: Iterable[tuple[str, str]]) -> bool:
        """Whether one of these hands, each with the hash of its model, has a first lesson."""
        return any(e.model == model for hand, model in hands for e in self.experiences(hand, ("seed",)))

    def _replace_weights(self, row: records.Row, instead_of: NetworkWeights | None = None) -> bool:
        """Store a row of weights by the rule of :meth:`save_weights`; returns whether it is stored now."""
        if self.weights(row[0]) is None:  # malformed ones would count as trained on more samples
            self._connection.execute("DELETE FROM weights WHERE hand = ?", row[:1])
        if instead_of is not None:
            self._connection.execute(
                "DELETE FROM weights WHERE hand = ? AND w1 = ? AND trained_on = ?",
                (row[0], records.packed(instead_of.w1), instead_of.trained_on),
            )
        return self._connection.execute(_UPSERT, row).rowcount > 0

    def _insert(self, rows: Iterable[records.Row]) -> Iterator[int]:
        with closing(self._connection.cursor()) as cursor:
            for row in rows:
                cursor.execute(_INSERT, row)
                yield int(cursor.lastrowid or 0)

    def _own_files(self) -> Iterator[Path]:
        for suffix in ("", "-wal", "-shm"):
            own = Path(self.where + suffix)
            if own.exists():
                yield own


def _weights_in(row: records.Row) -> NetworkWeights | None:
    """The weights in a row; None if they are malformed."""
    try:
        return records.weights_from_row(row)
    except InputError:
        return None


def _absolute(where: str) -> Path:
    try:
        return Path(where).expanduser().resolve()
    except RuntimeError as error:  # no such user, or links in a circle
        raise EnvironmentFailure(f"the memory {where} cannot be found ({error}); {ELSEWHERE}") from error
