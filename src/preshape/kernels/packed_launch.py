"""Arrays and launches that are kept between calls: making them anew costs more than a small batch's work."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..types import IntArray
from .launch import in_parts, part_count, warp

LEAST_ROOM = 64
"""Rows that an array has room for at first."""
FIRST = object()
"""Stands for the number of the first row, among the arguments of a :class:`Launch`."""


class Rows:
    """An array on a device, with room for as many rows as were ever asked for.

    Args:
        dtype: Warp's type of an element.
        shape: of a row; empty for one element.
        device: ``cpu`` or a CUDA device's name.
    """

    def __init__(self, dtype: Any, *shape: int, device: str) -> None:
        self._dtype, self._shape, self._device = dtype, shape, device
        self.array: Any = None
        self._seen: Any = None
        self.capacity = 0

    def room(self, count: int) -> None:
        """Make room for ``count`` rows; what was there may be lost."""
        if count <= self.capacity:
            return
        self.capacity = max(LEAST_ROOM, count, 2 * self.capacity)
        self.array = warp().zeros((self.capacity, *self._shape), dtype=self._dtype, device=self._device)
        # The host's own memory, where the device is the host.
        self._seen = self.array.numpy() if self._device == "cpu" else None

    def put(self, values: Any) -> None:
        """Write the first rows.

        Args:
            values: (n, ...) array.
        """
        self.room(len(values))
        if not len(values):
            return
        if self._seen is None:
            self.array[: len(values)].assign(np.ascontiguousarray(values))
        else:
            self._seen[: len(values)] = values

    def get(self, which: int | IntArray) -> Any:
        """A copy of the first so many rows, or of those with these numbers."""
        if self._seen is not None:
            return self._seen[:which].copy() if isinstance(which, int | np.integer) else self._seen[which]
        count = which if isinstance(which, int | np.integer) else int(which.max(initial=-1)) + 1
        if not count:
            return warp().zeros((0, *self._shape), dtype=self._dtype, device="cpu").numpy()
        host = np.array(self.array[:count].numpy())
        return host if isinstance(which, int | np.integer) else host[which]


class Launch:
    """A kernel whose arguments are packed once.

    Args:
        kernel: of Warp.
        arguments: in the kernel's order; :class:`Rows` stand for their arrays, :data:`FIRST` for the number
            of the first row of a part.
        device: ``cpu`` or a CUDA device's name.
        threads: parts that run side by side on the CPU.
    """

    def __init__(self, kernel: Any, arguments: Sequence[Any], *, device: str, threads: int) -> None:
        self._kernel, self._arguments = kernel, list(arguments)
        self._device, self._threads = device, threads
        self._first = next(k for k, item in enumerate(self._arguments) if item is FIRST)
        self._rows = {k: item for k, item in enumerate(self._arguments) if isinstance(item, Rows)}
        self._commands: list[Any] = []
        self._known: dict[int, Any] = {}
        self.lock = threading.Lock()
        """To be held from the writing of the rows until the reading of the results."""

    def __call__(self, count: int, changed: Mapping[int, Any] | None = None) -> None:
        """Run the kernel on the first ``count`` rows.

        Args:
            count: how many.
            changed: arguments, by their place, that may differ from those of the call before.
        """
        for rows in self._rows.values():
            rows.room(max(1, count))
        now: dict[int, Any] = {k: rows.array for k, rows in self._rows.items()} | dict(changed or {})
        fresh = {k: item for k, item in now.items() if k not in self._known or self._known[k] is not item}
        for command in self._commands:
            for k, item in fresh.items():
                command.set_param_at_index(k, item)
        self._known |= fresh
        for _ in range(len(self._commands), part_count(count, self._threads)):
            self._commands.append(self._command())
        spare = list(self._commands)

        def part(first: int, size: int) -> None:
            command = spare.pop()
            command.set_dim(size)
            command.set_param_at_index(self._first, first)
            command.launch()

        in_parts(part, count, self._threads)

    def _command(self) -> Any:
        given = [self._known.get(k, item) for k, item in enumerate(self._arguments)]
        given[self._first] = 0
        return warp().launch(self._kernel, dim=1, inputs=given, device=self._device, record_cmd=True)
