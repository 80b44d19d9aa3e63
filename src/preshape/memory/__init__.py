"""The memory: experiences and network weights in one SQLite file.

>>> with Memory.open(":memory:") as memory:
...     memory.count()
0

Everything that :meth:`Memory.add` has stored survives if the process is killed, and several processes may use
one file at once. The modules: :mod:`.checks` and :mod:`.records` (values to plain fields and back),
:mod:`.failures` (SQLite's errors as errors of this package), :mod:`.schema` (tables, versions, opening),
:mod:`.store` (the class :class:`Memory`), :mod:`.summary` (counts) and :mod:`.transfer` (export and import).
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
