"""Learning that lasts: experiences and network weights in one SQLite file.

>>> with Memory.open(":memory:") as memory:
...     memory.count()
0

What :meth:`Memory.add` has acknowledged survives the death of the process at any moment; several
processes may use one file at once. The parts: :mod:`.checks` and :mod:`.records` (values to
plain fields and back), :mod:`.failures` (SQLite's errors in our words), :mod:`.schema` (tables,
versions, opening), :mod:`.store` (the :class:`Memory`), :mod:`.summary` (what it holds, in numbers) and
:mod:`.transfer` (the exported document).
"""

from __future__ import annotations

from .records import KINDS
from .schema import APPLICATION_ID, MIGRATIONS, SCHEMA_VERSION
from .store import Memory, default_path
from .summary import MemoryStatistics, ObjectSummary
from .transfer import FORMAT_NAME, FORMAT_VERSION

__all__ = [
    "APPLICATION_ID",
    "FORMAT_NAME",
    "FORMAT_VERSION",
    "KINDS",
    "MIGRATIONS",
    "SCHEMA_VERSION",
    "Memory",
    "MemoryStatistics",
    "ObjectSummary",
    "default_path",
]
