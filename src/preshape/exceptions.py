"""Every error that preshape raises on purpose, on one screen.

::

    PreshapeError                 the root; its exit_code is what the command line returns
    ├── InputError           2    what was given cannot be used; says what to change
    │   ├── ObjectError           an object file or mesh
    │   ├── TaskError             a task
    │   ├── HandError             a hand description
    │   ├── MemoryFileError       a file that is not a memory, or one of a newer version
    │   └── UnknownName           a name that is not known; lists the nearest ones
    │       ├── UnknownObject
    │       ├── UnknownTask
    │       └── UnknownHand
    ├── EnvironmentFailure   3    files, disk, environment: the input may be right
    └── Cancelled          130    the caller stopped the work; what was acknowledged is kept

A bad argument is an exception; a bad grasp is a result with a status and a reason.
Every message is one sentence or two: what was expected, what came, what to do.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import ClassVar


class PreshapeError(Exception):
    """Root of all errors of this package.

    Attributes:
        exit_code: what the command line returns for this error.
    """

    exit_code: ClassVar[int] = 2


class InputError(PreshapeError):
    """What was given cannot be used."""


class ObjectError(InputError):
    """An object file or mesh that cannot be grasped as it is."""


class TaskError(InputError):
    """A task that is not six finite numbers, a known name, or a displacement."""


class HandError(InputError):
    """A hand description that is incomplete or contradicts itself."""


class MemoryFileError(InputError):
    """A memory file that is not one, or that a newer version wrote."""


class UnknownName(InputError):
    """A name that does not exist.

    Args:
        name: what was asked for.
        known: the names that exist.

    Survives pickling: both arguments are kept in ``args``.

    >>> str(UnknownTask("lit", ["lift", "pour"]))
    "no task 'lit'; did you mean lift? Known: lift, pour"
    """

    noun: ClassVar[str] = "name"
    more: ClassVar[str] = ""

    def __init__(self, name: str, known: Iterable[str]) -> None:
        self.name = name
        self.known = tuple(known)
        super().__init__(name, self.known)

    def nearest(self, count: int = 3) -> tuple[str, ...]:
        """The known names most like the one asked for, best first."""
        if not self.name.strip():
            return ()
        close = difflib.get_close_matches(self.name.lower(), self.known, n=count, cutoff=0.4)
        inside = [known for known in self.known if self.name.lower() in known.lower()]
        return tuple(dict.fromkeys([*inside, *close]))[:count]

    def __str__(self) -> str:
        hint = self.nearest()
        known = ", ".join(self.known)
        guess = f"did you mean {' or '.join(hint)}? Known: {known}" if hint else f"known: {known}"
        return f"no {self.noun} {self.name!r}; {guess}{self.more}"


class UnknownObject(UnknownName):
    """No library object of that name, and no file either."""

    noun = "file or built-in object"


class UnknownTask(UnknownName):
    """No task family of that name."""

    noun = "task"


class UnknownHand(UnknownName):
    """No hand of that name."""

    noun = "hand"
    more = " (NAME:left for a left one, or your own TOML)"


class EnvironmentFailure(PreshapeError):
    """A file, the disk or the environment failed; the input may be right."""

    exit_code: ClassVar[int] = 3


class Cancelled(PreshapeError):
    """The caller stopped the work."""

    exit_code: ClassVar[int] = 130
