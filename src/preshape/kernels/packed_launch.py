"""Device arrays and kernel launches with packed arguments, both reused between calls.

Creating them for each call would take longer than the computation of a small batch.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..types import IntArray
from .launch import in_parts, part_count, warp

LEAST_CAPACITY = 64
"""Number of rows of a new array."""
FIRST_ROW = object()
"""Argument of a :class:`PackedLaunch` that stands for the index of the first row of the launched part."""


class DeviceRows:
    """An array on a device whose capacity grows with the largest number of rows that was needed.

    Args:
        dtype: Warp's type of an element.
        shape: Shape of a row; empty for one element.
        device: ``cpu`` or a CUDA device's name.
    """

    def __init__(self, dtype: Any, *shape: int, device: str) -> None:
        self._dtype, self._shape, self._device = dtype, shape, device
        self.array: Any = None
        self._host_view: Any = None
        self.capacity = 0

    def reserve(self, count: int) -> None:
        """Make room for ``count`` rows; the content may be lost."""
        if count <= self.capacity:
            return
        self.capacity = max(LEAST_CAPACITY, count, 2 * self.capacity)
        self.array = warp().zeros((self.capacity, *self._shape), dtype=self._dtype, device=self._device)
        # On the CPU, NumPy reads and writes the array's own memory.
        self._host_view = self.array.numpy() if self._device == "cpu" else None

    def put(self, values: Any) -> None:
        """Write an array (n, ...) to the first n rows."""
        self.reserve(len(values))
        if not len(values):
            return
        if self._host_view is None:
            self.array[: len(values)].assign(np.ascontiguousarray(values))
        else:
            self._host_view[: len(values)] = values

    def get(self, which: int | IntArray) -> Any:
        """A copy of the first ``which`` rows, or of the rows with the indices ``which``."""
        leading = isinstance(which, int | np.integer)
        if self._host_view is not None:
            return self._host_view[:which].copy() if leading else self._host_view[which]
        count = which if isinstance(which, int | np.integer) else int(which.max(initial=-1)) + 1
        if not count:
            return warp().zeros((0, *self._shape), dtype=self._dtype, device="cpu").numpy()
        host = np.array(self.array[:count].numpy())
        return host if leading else host[which]


class PackedLaunch:
    """A kernel whose arguments are packed once; later calls replace only those that changed.

    Args:
        kernel: A Warp kernel.
        arguments: Its arguments by name, in the kernel's order. :class:`DeviceRows` stand for their arrays,
            :data:`FIRST_ROW` for the index of the first row of a part.
        device: ``cpu`` or a CUDA device's name.
        threads: Largest number of CPU threads.

    Attributes:
        lock: Lock to hold from writing the input rows until the results are read.
    """

    def __init__(self, kernel: Any, arguments: Mapping[str, Any], *, device: str, threads: int) -> None:
        assert list(arguments) == [argument.label for argument in kernel.adj.args]
        self._kernel, self._arguments = kernel, list(arguments.values())
        self._device, self._threads = device, threads
        self._place = {name: k for k, name in enumerate(arguments)}
        self._first = next(k for k, item in enumerate(self._arguments) if item is FIRST_ROW)
        self._rows = {k: item for k, item in enumerate(self._arguments) if isinstance(item, DeviceRows)}
        self._commands: list[Any] = []
        self._packed: dict[int, Any] = {}
        self._parts: dict[Any, tuple[int, int]] = {}  # what each command was last launched for
        self.lock = threading.Lock()

    def __call__(self, count: int, changed: Mapping[str, Any] | None = None) -> None:
        """Run the kernel on the first ``count`` rows.

        Args:
            count: Number of rows.
            changed: Arguments that may differ from those of the last call, by name.
        """
        for rows in self._rows.values():
            rows.reserve(max(1, count))
        now: dict[int, Any] = {k: rows.array for k, rows in self._rows.items()}
        now |= {self._place[name]: item for name, item in (changed or {}).items()}
        fresh = {k: item for k, item in now.items() if k not in self._packed or self._packed[k] is not item}
        for command in self._commands:
            for k, item in fresh.items():
                command.set_param_at_index(k, item)
        self._packed |= fresh
        for _ in range(len(self._commands), part_count(count, self._threads)):
            self._commands.append(self._command())
        spare = list(self._commands)

        def part(first: int, size: int) -> None:
            command = spare.pop()
            if self._parts.get(command) != (first, size):
                command.set_dim(size)
                command.set_param_at_index(self._first, first)
                self._parts[command] = first, size
            command.launch()

        in_parts(part, count, self._threads)

    def _command(self) -> Any:
        given = [self._packed.get(k, item) for k, item in enumerate(self._arguments)]
        given[self._first] = 0
        return warp().launch(self._kernel, dim=1, inputs=given, device=self._device, record_cmd=True)
