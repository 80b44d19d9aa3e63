"""Contact rules: the parts of an object that the hand may touch, and those that it must stay away from."""

from __future__ import annotations

import numpy as np

from ..exceptions import InputError, shown
from ..objects.parts import PartSurface
from ..types import freeze, value

KEEP_OFF = 0.003
"""Least distance of contacts and links from a part that is kept off [m] [C]."""

_HOLD, _OFF = "hold on ", "keep off "


@value
class ContactRules:
    """Where contacts may be, and what the hand must stay away from.

    Attributes:
        hold_on: Parts that contacts must lie on, any of them; without parts, the whole surface.
        keep_off: Parts without contacts on them, and with no link within ``KEEP_OFF`` of them. Distances are
            measured straight, through a wall too. A volume that the hand shall only stay out of is therefore
            given smaller than the space itself where a wall is thinner than ``KEEP_OFF``.

    Raises:
        InputError: Something else than parts was given, or a part has no surface.
    """

    hold_on: tuple[PartSurface, ...] = ()
    keep_off: tuple[PartSurface, ...] = ()

    def __post_init__(self) -> None:
        for name in ("hold_on", "keep_off"):
            given = getattr(self, name)
            if not isinstance(given, tuple | list) or not all(isinstance(p, PartSurface) for p in given):
                raise InputError(f"{name} must be parts of an object (PartSurface), got {shown(given)}")
            for part in given:
                a, b, c = (part.vertices[part.triangles[:, k]] for k in range(3))
                if not np.cross(b - a, c - a).any():
                    raise InputError(f"the part {part.name} has no surface; choose a larger region")
            freeze(self, **{name: tuple(given)})

    def __len__(self) -> int:
        return len(self.names)

    @property
    def names(self) -> tuple[str, ...]:
        """Each rule in words: first where to hold, if that is asked, then each part to keep off.

        >>> part = PartSurface(name="rim", vertices=[[0, 0, 0], [1, 0, 0], [0, 1, 0]], triangles=[[0, 1, 2]])
        >>> ContactRules(keep_off=(part,)).names
        ('keep off rim',)
        """
        hold = (f"{_HOLD}{' or '.join(part.name for part in self.hold_on)}",) if self.hold_on else ()
        return (*hold, *(f"{_OFF}{part.name}" for part in self.keep_off))


def breaks(rule: str) -> str:
    """What refuses a grip that breaks a rule of :attr:`ContactRules.names`, as a clause."""
    return f"it would break the rule to {rule}"


def is_rule(name: str) -> bool:
    """Whether a name of what refuses hands is that of a rule.

    >>> is_rule("keep off rim"), is_rule("the table")
    (True, False)
    """
    return name.startswith((_HOLD, _OFF))
