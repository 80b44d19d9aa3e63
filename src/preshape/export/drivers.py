"""Drivers of hands: which number each motor's command becomes, in which order and under which name."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import EnvironmentFailure, InputError, shown
from ..files import path_of, read_file
from ..hands.hand import Hand
from ..types import Array, finite_number, frozen_array, value

DRIVERS = ("leap", "allegro", "shadow", "inspire")
"""Names of the built-in drivers."""
_LARGEST = 1_000_000
"""Largest size of a driver's file [bytes]."""
_KEYS = {"name", "unit", "source", "whole", "channel"}
_CHANNEL_KEYS = {"name", "motor", "offset", "factor", "at_lower", "at_upper", "least", "most"}


@value
class DriverChannel:
    """One number of a driver.

    The number is ``offset + factor · command``; or, with ``ends``, it runs linearly from the first of them at
    the motor's lower limit to the second at its upper one.

    Attributes:
        name: Name in the driver; empty for the motor's own.
        motors: Names of the motor in models of the hand; a longer name that ends in ``_`` and one of them is
            the motor too.
        offset: Number at the command zero.
        factor: Change of the number by 1 rad of the command; its sign is that of the driver's axis.
        ends: Numbers at the lower and upper limit of the motor, or ``None``.
        least: Smallest number that the driver accepts.
        most: Largest number that it accepts.
    """

    name: str
    motors: tuple[str, ...]
    offset: float = 0.0
    factor: float = 1.0
    ends: tuple[float, float] | None = None
    least: float = -np.inf
    most: float = np.inf

    def fits(self, motor: str) -> bool:
        """Whether a motor of a model is this channel's."""
        return any(motor == name or motor.endswith(f"_{name}") for name in self.motors)


@value
class Driver:
    """The numbers that a hand's own driver takes, in its order.

    Attributes:
        name: Name of the driver.
        unit: Unit of its numbers, for display.
        source: Where the map comes from.
        channels: Its numbers.
        whole: Whether the numbers are whole ones.
    """

    name: str
    unit: str
    source: str
    channels: tuple[DriverChannel, ...]
    whole: bool = False

    def commands(self, hand: Hand, commands: Array) -> DriverCommands:
        """The driver's numbers for commands of the hand's motors.

        Args:
            hand: The hand.
            commands: (n, m) commands in the order of the hand's motors [rad].

        Raises:
            InputError: A channel fits no motor or several, or a motor has no channel.
        """
        given = frozen_array(commands, (None, len(hand.motors)), "commands of the motors")
        names = [motor.name for motor in hand.motors]
        columns, labels = [], []
        for channel in self.channels:
            fitting = [k for k, name in enumerate(names) if channel.fits(name)]
            if len(fitting) != 1:
                found = "none" if not fitting else " and ".join(names[k] for k in fitting)
                raise InputError(
                    f"the driver {self.name} needs one motor called {' or '.join(channel.motors)}, and the "
                    f"hand {hand.name} has {found}; its motors are {', '.join(names)}: take the driver of "
                    "this hand, or give a TOML file of your own (docs/ros.md)"
                )
            columns.append(fitting[0])
            labels.append(channel.name or names[fitting[0]])
        left = [name for k, name in enumerate(names) if k not in columns]
        if left or len(set(columns)) != len(columns):
            raise InputError(
                f"the driver {self.name} leaves out the motor {(left or names)[0]} of the hand {hand.name}: "
                "every motor needs one channel"
            )
        numbers, ranges = given[:, columns].copy(), hand.ranges()
        for k, channel in enumerate(self.channels):
            if channel.ends is None:
                numbers[:, k] = channel.offset + channel.factor * numbers[:, k]
            else:
                low, high = ranges[columns[k]]
                numbers[:, k] = np.interp(numbers[:, k], (low, high), channel.ends)
        if self.whole:
            numbers = numbers.round()
        inside = np.clip(numbers, [c.least for c in self.channels], [c.most for c in self.channels])
        cut = np.flatnonzero((np.abs(inside - numbers) > 1e-9).any(axis=0))
        return DriverCommands(
            names=tuple(labels), columns=tuple(columns), numbers=inside, cut=tuple(labels[k] for k in cut)
        )


@value
class DriverCommands:
    """Numbers for a driver.

    Attributes:
        names: (k,) Names of the channels.
        columns: (k,) Index of each channel's motor.
        numbers: (n, k) Numbers, within the driver's limits.
        cut: Names of the channels of which a number was cut to the driver's limits.
    """

    names: tuple[str, ...]
    columns: tuple[int, ...]
    numbers: Array
    cut: tuple[str, ...]


def load_driver(name: str) -> Driver:
    """A built-in driver by name, or the driver of a TOML file.

    Raises:
        InputError: There is neither, or the file describes no driver.
        EnvironmentFailure: The file cannot be read.
    """
    if name in DRIVERS:
        text = files(__package__).joinpath("drivers", f"{name}.toml").read_text(encoding="utf-8")
    elif name.lower().endswith(".toml"):
        try:
            text = read_file(path_of(name, "the driver's file"), _LARGEST, "driver's file").decode("utf-8")
        except UnicodeDecodeError as error:
            raise InputError(f"the driver {shown(name)} is no text in UTF-8 ({error.reason})") from error
        except OSError as error:
            raise EnvironmentFailure(f"{name} cannot be read: {error.strerror or error}") from error
    else:
        raise InputError(
            f"no driver {shown(name)}; known: {', '.join(DRIVERS)}, or a TOML file of your own (docs/ros.md)"
        )
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"the driver {shown(name)} is no TOML: {error}") from error
    return _driver(data, name)


def _driver(data: dict[str, Any], name: str) -> Driver:
    """The driver of a parsed file.

    Raises:
        InputError: A key is unknown, missing or of the wrong kind.
    """
    _known(data, _KEYS, f"the driver {shown(name)}")
    channels = data.get("channel")
    if not isinstance(channels, list) or not channels or not all(isinstance(c, dict) for c in channels):
        raise InputError(f"the driver {shown(name)} needs [[channel]] tables, one for each motor")
    if not isinstance(data.get("whole", False), bool):
        raise InputError(f"the driver {shown(name)}: whole must be true or false")
    return Driver(
        name=_text(data, "name", name, Path(name).stem),
        unit=_text(data, "unit", name, "rad"),
        source=_text(data, "source", name, ""),
        channels=tuple(_channel(channel, f"{name}, channel {k + 1}") for k, channel in enumerate(channels)),
        whole=data.get("whole", False),
    )


def _channel(data: dict[str, Any], where: str) -> DriverChannel:
    _known(data, _CHANNEL_KEYS, f"the driver {shown(where)}")
    motors = data.get("motor")
    listed = [motors] if isinstance(motors, str) else motors
    if not isinstance(listed, list) or not listed or not all(isinstance(m, str) and m for m in listed):
        raise InputError(f"the driver {shown(where)}: motor must be the name of a motor, or a list of names")
    ends = None
    if "at_lower" in data or "at_upper" in data:
        if "offset" in data or "factor" in data or not {"at_lower", "at_upper"} <= set(data):
            raise InputError(
                f"the driver {shown(where)}: give at_lower and at_upper, or offset and factor, not a mixture"
            )
        ends = tuple(_number(data, key, where, 0.0) for key in ("at_lower", "at_upper"))
    return DriverChannel(
        name=_text(data, "name", where, ""),
        motors=tuple(listed),
        offset=_number(data, "offset", where, 0.0),
        factor=_number(data, "factor", where, 1.0),
        ends=None if ends is None else (ends[0], ends[1]),
        least=_number(data, "least", where, -np.inf),
        most=_number(data, "most", where, np.inf),
    )


def _known(data: dict[str, Any], keys: set[str], what: str) -> None:
    for key in data:
        if key not in keys:
            raise InputError(f"{what} has no key {shown(key)}; it has {', '.join(sorted(keys))}")


def _text(data: dict[str, Any], key: str, where: str, default: str) -> str:
    text = data.get(key, default)
    if not isinstance(text, str) or not text.isprintable():
        raise InputError(f"the driver {shown(where)}: {key} must be text of one line, got {shown(text)}")
    return text


def _number(data: dict[str, Any], key: str, where: str, default: float) -> float:
    return finite_number(data[key], f"the driver {shown(where)}: {key}") if key in data else default
