"""What takes a second to work out of a hand is kept on disk, by the hand's content.

A file that cannot be read is made anew; a folder that cannot be written is done without.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from ..files import cache_folder, keep_arrays, read_arrays
from ..hands.hand import Hand

VERSION = 3
"""To be raised when tables or preshapes are made otherwise."""
_T = TypeVar("_T")


def kept(kind: type[_T], hand: Hand, label: str, make: Callable[[], _T]) -> _T:
    """A value of arrays and names, from disk where it was made before.

    Args:
        kind: the value's class, a dataclass of arrays, numbers, and tuples of text.
        hand: what it was made of.
        label: what it is, with every setting that it depends on.
        make: makes it.
    """
    file = cache_folder() / "hands" / f"{digest(hand, label)}.npz"
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        arrays = read_arrays(file)
        plain = json.loads(str(arrays.pop("plain")))
        plain = {name: tuple(item) if isinstance(item, list) else item for name, item in plain.items()}
        return kind(**plain, **arrays)
    made = make()
    values = {field.name: getattr(made, field.name) for field in fields(made)}  # type: ignore[arg-type]
    arrays = {name: item for name, item in values.items() if isinstance(item, np.ndarray)}
    plain = {name: item for name, item in values.items() if name not in arrays}
    keep_arrays(file, **arrays, plain=np.array(json.dumps(plain)))
    return made


def digest(hand: Hand, label: str) -> str:
    """Hash of a hand's content and a label."""
    state = hashlib.sha256(f"{VERSION} {label}".encode())
    for field in fields(hand):
        if field.name == "fingers":
            for finger in hand.fingers:
                for part in fields(finger):
                    _add(state, part.name, getattr(finger, part.name))
        elif field.name != "source":  # the same hand in another folder is the same hand
            _add(state, field.name, getattr(hand, field.name))
    return state.hexdigest()


def _add(state: Any, name: str, item: object) -> None:
    state.update(name.encode())
    state.update(item.tobytes() if isinstance(item, np.ndarray) else repr(item).encode())
