"""What a client may name in a request: built-in things, meshes that it sent, and files of one folder."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..exceptions import InputError, shown
from ..hands.load import SIDES, hand_names
from ..objects.library import names as object_names
from .shelf import PREFIX, Shelf

_PART = re.compile(r"#(\d+|all)$")
_POSE = re.compile(r"@[-+0-9.,eE ]+$")


class Admission:
    """Turns the names of a request into those that a planner process takes.

    Paths are read with the server's rights, and whoever reaches the port, on a machine with several users
    each of them, would learn what is in such files. So over the network a path must lie within one folder.

    Args:
        shelf: The meshes that clients have sent.
        folder: The folder whose files may be named; ``None`` for none.
    """

    def __init__(self, shelf: Shelf, folder: Path | None) -> None:
        self._shelf = shelf
        self._folder = None if folder is None else Path(os.path.realpath(folder))

    def admit(self, data: dict[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
        """The request for a planner process, and the names of files that only the server knows.

        Args:
            data: The request as the client sent it, in the short or the long form.

        Raises:
            InputError: It names something else.
        """
        names: dict[str, str] = {}
        admitted = dict(data)
        thing = data.get("object")
        if isinstance(thing, dict) and isinstance(thing.get("source"), str):
            admitted["object"] = {**thing, "source": self._object(thing["source"], names)}
        elif isinstance(thing, str):
            admitted["object"] = self._object(thing, names)
        if isinstance(hand := data.get("hand"), str):
            admitted["hand"] = self._hand(hand)
        if isinstance(arm := data.get("arm"), str):
            admitted["arm"] = self._inside(arm, "an arm is")
        for owner in (admitted, admitted.get("object")):
            if isinstance(owner, dict) and isinstance(mask := owner.get("mask"), str) and not mask.isdigit():
                owner["mask"] = self._ending(mask, _PART, {})
        if isinstance(around := data.get("obstacle"), str | list):
            around = [around] if isinstance(around, str) else around
            admitted["obstacle"] = [
                self._obstacle(text) if isinstance(text, str) else text for text in around
            ]
        return admitted, names

    def _object(self, text: str, names: dict[str, str]) -> str:
        return text if text in object_names() else self._ending(text, _PART, names)

    def _obstacle(self, text: str) -> str:
        return self._ending(text, _POSE, {})

    def _ending(self, text: str, ending: re.Pattern[str], names: dict[str, str]) -> str:
        """The file that a text names, with the part or the pose that stands at its end."""
        found = ending.search(text)
        file, rest = (text[: found.start()], found[0]) if found else (text, "")
        if not file.startswith(PREFIX):
            wanted = "an object is a built-in name (preshape objects), a mesh that was sent, or"
            return self._inside(file, wanted) + rest
        sent = self._shelf.get(file)
        names[f"{sent.path}{rest}"] = f"{sent.name}{rest}"
        names[str(sent.path)] = sent.name
        return f"{sent.path}{rest}"

    def _hand(self, text: str) -> str:
        name, _, side = text.partition(":")
        if name in hand_names() and (not side or side in SIDES):
            return text
        return self._inside(text, "a hand is a built-in name (preshape hands), or")

    def _inside(self, text: str, wanted: str) -> str:
        """The real path of a file in the folder.

        Raises:
            InputError: There is no folder, or the path leads out of it.
        """
        path = ""
        with suppress(OSError, ValueError):
            path = "" if self._folder is None else os.path.realpath(self._folder / text)
        if not path.startswith(f"{self._folder}{os.sep}"):
            raise InputError(f"{wanted} a file in the folder of --files, got {shown(text)}")
        return path
