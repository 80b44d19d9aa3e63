"""The errors that preshape raises.

::

    PreshapeError                 root; its exit_code is the exit code of the command line
    ├── InputError           2    an input cannot be used; the message says what to change
    │   ├── ObjectError           an object file or mesh
    │   ├── TaskError             a task
    │   ├── HandError             a hand description
    │   ├── ArmError              an arm's model, or how it carries the hand
    │   ├── MemoryFileError       a file that is no memory, or one of a newer version
    │   └── UnknownName           an unknown name; the message lists the nearest known names
    │       ├── UnknownObject
    │       ├── UnknownTask
    │       ├── UnknownHand
    │       └── UnknownKey        a key of a request or of preshape.toml
    ├── EnvironmentFailure   3    a file, the disk or the environment; the input may be right
    └── Cancelled          130    the caller stopped the work; acknowledged results are kept

A bad argument raises an exception; a bad grasp is a result with a status and a reason.
Each message is one or two sentences: what was expected, what came, what to do.
"""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable
from typing import ClassVar

_LONGEST = 60
_short = reprlib.Repr()
_short.maxstring = _short.maxother = _short.maxlong = _LONGEST


def shown(given: object) -> str:
    """What a caller gave, for messages: its ``repr`` in one line, with ``...`` for the middle of a long one.

    >>> shown("lift"), len(shown("lift " * 1000))
    ("'lift'", 60)
    """
    try:
        return " ".join(_short.repr(given).split())
    except Exception:  # a foreign object's own repr may fail in any way
        return f"a value of {type(given).__name__}"


class PreshapeError(Exception):
    """Root of all errors of this package.

    Attributes:
        exit_code: Exit code of the command line for this error.
    """

    exit_code: ClassVar[int] = 2


class InputError(PreshapeError):
    """An input cannot be used."""


class ObjectError(InputError):
    """An object file or mesh that cannot be grasped as it is."""


class TaskError(InputError):
    """A task that is not six finite numbers, a known name, or a displacement."""


class HandError(InputError):
    """A hand description that is incomplete or contradicts itself."""


class ArmError(InputError):
    """An arm's model that cannot carry the hand, or a link that it does not have."""


class MemoryFileError(InputError):
    """A file that is no memory, or a memory that a newer version wrote."""


class UnknownName(InputError):
    """A name that does not exist.

    Args:
        name: The unknown name.
        known: The known names.

    >>> str(UnknownTask("lit", ["lift", "pour"]))
    "no task 'lit'; did you mean lift? Known: lift, pour"
    """

    noun: ClassVar[str] = "name"
    more: ClassVar[str] = ""

    def __init__(self, name: str, known: Iterable[str]) -> None:
        self.name = name
        self.known = tuple(known)
        super().__init__(name, self.known)  # pickling calls the constructor with these

    def nearest(self, count: int = 3) -> tuple[str, ...]:
        """The known names that are most similar, best first."""
        name = self.name.strip().lower()
        if not name or len(name) > 2 * _LONGEST:
            return ()
        close = difflib.get_close_matches(name, self.known, n=count, cutoff=0.4)
        inside = [known for known in self.known if name in known.lower()]
        return tuple(dict.fromkeys([*inside, *close]))[:count]

    def __str__(self) -> str:
        hint = self.nearest()
        known = ", ".join(self.known)
        guess = f"did you mean {' or '.join(hint)}? Known: {known}" if hint else f"known: {known}"
        return f"no {self.noun} {shown(self.name)}; {guess}{self.more}"


class UnknownObject(UnknownName):
    """There is neither a library object nor a file of that name."""

    noun = "file or built-in object"


class UnknownTask(UnknownName):
    """There is no task family of that name; the message also suggests tasks for common words.

    >>> UnknownTask("pick it up", ["lift", "pour", "hand_over"]).nearest()
    ('lift', 'hand_over')
    """

    noun = "task"
    # What people say, and the tasks that do it.
    _MEANT: ClassVar[dict[str, str]] = {
        "lift": "pick grasp grab hold take raise carry move up keep catch get",
        "hand_over": "pick carry give pass bring place handover move",
        "insert": "place put set plug lower down peg",
        "press": "squeeze place put stamp click",
        "slide": "wipe drag shift move place sweep",
        "strike": "hammer hit knock swing beat",
        "turn": "rotate spin dial knob",
        "twist": "rotate wring key unlock lock",
        "screw": "tighten bolt fasten drive",
        "unscrew": "loosen unbolt uncap",
        "pour": "tilt drink tip fill empty serve",
        "push": "shove close",
        "pull": "draw tug drag",
        "lever": "pry bend",
        "shake": "stir mix rattle",
        "open": "door drawer swing",
    }

    def nearest(self, count: int = 3) -> tuple[str, ...]:
        """The tasks that a word of the text names, means or resembles, best first."""
        words = self.name.lower().replace("_", " ").split()[:20]
        named = [known for known in self.known if known in words]
        meant = [known for word in words for known in self._MEANT if word in self._MEANT[known].split()]
        found = [known for known in (*named, *meant) if known in self.known]
        return tuple(dict.fromkeys(found))[:count] or super().nearest(count)


class UnknownHand(UnknownName):
    """There is no hand of that name."""

    noun = "hand"
    more = " (NAME:left for a left hand, or a TOML file of your own)"


class UnknownKey(UnknownName):
    """There is no key of that name in a request or in a file of settings."""

    noun = "key"


class EnvironmentFailure(PreshapeError):
    """A file, the disk or the environment failed; the input may be right."""

    exit_code: ClassVar[int] = 3


class Cancelled(PreshapeError):
    """The caller stopped the work."""

    exit_code: ClassVar[int] = 130
