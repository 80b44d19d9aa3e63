"""One palette for all pictures: the eight colours of Okabe and Ito, which colour-blind readers tell apart."""

from __future__ import annotations

from typing import Final, TypeAlias

Colour: TypeAlias = tuple[float, float, float]
"""Red, green and blue, each 0..1, sRGB."""


def from_hex(text: str) -> Colour:
    """The colour of a six-digit hexadecimal code.

    >>> from_hex("#ff0033")
    (1.0, 0.0, 0.2)
    """
    red, green, blue = (int(text.lstrip("#")[i : i + 2], 16) / 255 for i in (0, 2, 4))
    return red, green, blue


def to_bytes(colour: Colour) -> tuple[int, int, int]:
    """Red, green and blue, each 0..255.

    >>> to_bytes((1.0, 0.0, 0.2))
    (255, 0, 51)
    """
    red, green, blue = (round(255 * channel) for channel in colour)
    return red, green, blue


ORANGE: Final = from_hex("#E69F00")
SKY: Final = from_hex("#56B4E9")
GREEN: Final = from_hex("#009E73")
YELLOW: Final = from_hex("#F0E442")
BLUE: Final = from_hex("#0072B2")
VERMILION: Final = from_hex("#D55E00")
PURPLE: Final = from_hex("#CC79A7")
BLACK: Final = from_hex("#000000")

INK: Final = from_hex("#22262B")
"""Text and lines."""
QUIET: Final = from_hex("#6B7480")
"""Secondary text."""
FAINT: Final = from_hex("#C9CFD6")
"""Rules, and outlines of planes that were not chosen."""
PAPER: Final = from_hex("#FFFFFF")
SKY_TOP: Final = from_hex("#E3E8EE")
SKY_BOTTOM: Final = from_hex("#FAFBFC")
"""Background of a rendered picture, from its top to its bottom."""

OBJECT: Final = from_hex("#D9D2C5")
HAND: Final = from_hex("#8FA3B8")
APPROACH: Final = BLUE
OPPOSITION: Final = VERMILION
TRANSVERSE: Final = GREEN
TABLE: Final = from_hex("#B9A88C")
AVOID: Final = PURPLE
TASK: Final = from_hex("#4A4F57")
WRENCH: Final = SKY

FINGERS: Final[dict[str, Colour]] = {
    "thumb": ORANGE,
    "index": PURPLE,
    "middle": SKY,
    "ring": YELLOW,
    "little": from_hex("#6A4FA3"),
}
"""One colour for each finger."""


def finger_colour(name: str, order: int) -> Colour:
    """The colour of a finger: by its name if ``FINGERS`` has it, otherwise by its place in the hand.

    The palm, which touches as fingers do, has the colour of text.

    Args:
        name: Name of the finger.
        order: Place of the finger in the hand, from 0.

    >>> finger_colour("Thumb", 3) == ORANGE
    True
    """
    if name == "palm":
        return INK
    known = [colour for finger, colour in FINGERS.items() if finger in name.lower()]
    return known[0] if known else list(FINGERS.values())[order % len(FINGERS)]
