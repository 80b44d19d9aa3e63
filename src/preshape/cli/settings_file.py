"""``preshape.toml``: usual hand, table, mass and memory, in the working or the user's configuration folder.

What the command line says wins over the file, and ``PRESHAPE_MEMORY`` wins over its memory.
"""

from __future__ import annotations

import os
from typing import Any, NamedTuple

from ..exceptions import EnvironmentFailure, InputError, UnknownKey, shown

TYPE_CHECKING = False
if TYPE_CHECKING:
    import click

NAME = "preshape.toml"
KEYS = ("hand", "table", "mass", "memory")
_FILES = (".toml", ".urdf", ".xml", ".mjcf", ".xacro")
_OF_COMMANDS = {
    "plan": KEYS,
    "learn": KEYS,
    "view": KEYS,
    "serve": ("memory",),
    "memory": ("memory",),
}
"""The commands that take the settings, and which of them."""
_OF_MEMORY = ("show", "export", "import", "reset")


class UserSettings(NamedTuple):
    """The content of a file.

    Attributes:
        path: The file.
        values: The settings, as their options take them.
    """

    path: str
    values: dict[str, Any]

    def of_commands(self) -> dict[str, Any]:
        """The defaults of each command's options, as Click takes them."""
        found: dict[str, Any] = {
            command: {key: self.values[key] for key in keys if key in self.values}
            for command, keys in _OF_COMMANDS.items()
        }
        found["memory"] = dict.fromkeys(_OF_MEMORY, found["memory"])
        return found


def find_file() -> str | None:
    """Path of the file: that in the working folder, else that in the user's configuration folder."""
    if os.path.lexists(NAME):  # a pipe or a folder of this name is refused by name, not passed over
        return os.path.abspath(NAME)
    import platformdirs

    path = os.path.join(platformdirs.user_config_dir("preshape", appauthor=False), NAME)
    return path if os.path.lexists(path) else None


def user_settings() -> UserSettings | None:
    """The settings of the user's file; ``None`` without a file.

    Raises:
        InputError: The file is no TOML, or a key or a value cannot be used.
        EnvironmentFailure: It cannot be read.
    """
    path = find_file()
    if path is None:
        return None
    import tomllib

    from ..files import MOST_OF_TOML, read_file

    try:
        content = tomllib.loads(read_file(path, MOST_OF_TOML, "file of settings").decode())
    except OSError as error:
        raise EnvironmentFailure(f"{path} cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is no TOML: {error!s:.120}") from error
    values = {}
    for key, value in content.items():
        if key not in KEYS:
            raise InputError(f"{path}: {UnknownKey(key, KEYS)}")
        values[key] = _checked(path, key, value)
    if os.environ.get("PRESHAPE_MEMORY"):
        values.pop("memory", None)
    return UserSettings(path, values)


def apply_settings(context: click.Context, command: str) -> None:
    """Make the settings the defaults of the command that follows, if it takes any.

    Args:
        context: The context of the group of all commands.
        command: The command.

    Raises:
        InputError: The file cannot be used.
        EnvironmentFailure: It cannot be read.
    """
    if command in _OF_COMMANDS and (found := user_settings()) is not None:
        context.obj, context.default_map = found, found.of_commands()


def name_settings() -> None:
    """Say on standard error which file's settings the current command uses, if it uses any."""
    import click
    from click.core import ParameterSource

    from .printing import say

    context = click.get_current_context()
    if context.obj is None:
        return
    sources = {key: context.get_parameter_source(key) for key in KEYS}
    used = [f"{key} {context.params[key]}" for key in KEYS if sources[key] is ParameterSource.DEFAULT_MAP]
    if used:
        say(f"settings of {context.obj.path}: {', '.join(used)}", err=True)


def _checked(path: str, key: str, value: Any) -> Any:
    """A value as the command line's option takes it; a path is relative to the folder of the file."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if key == "table" and isinstance(value, bool):
        return "auto" if value else "none"
    if key in ("table", "mass") and number:
        from ..types import finite_number

        return str(value) if key == "table" else finite_number(value, f"{path}: {key}")
    if key == "mass" or not isinstance(value, str) or not value.strip():
        wanted = {
            "hand": "the name or the file of a hand",
            "table": "auto, none or a height in metres",
            "mass": "a number of kilograms",
            "memory": "the path of a file",
        }[key]
        raise InputError(f"{path}: {key} must be {wanted}, got {shown(value)}")
    if key == "memory" or (key == "hand" and value.lower().endswith(_FILES)):
        value = os.path.join(os.path.dirname(path), os.path.expanduser(value))
    return value
