"""Cache of compiled kernels that a damaged, truncated or read-only file cannot break.

Warp loads whatever object file it finds in its cache. LLVM ends the process at a truncated one, with a signal
that nobody can catch, and Warp raises where its folder cannot be written. Therefore Warp never sees the
cache: each module of kernels is kept as one npz file, whose checksums are verified as it is read,

1. the file is unpacked to a new temporary folder, and Warp loads the kernels from there;
2. where the file is missing or damaged, Warp compiles the kernels in that folder first;
3. what was compiled is kept, in Warp's own cache folder or, where that cannot be written, in a folder of
   this user among the temporary files, which is named once;
4. the temporary folder is removed.

Reading the files of all kernels takes some milliseconds.
"""

from __future__ import annotations

import shutil
import tempfile
import threading
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np

from ..exceptions import EnvironmentFailure
from ..files import keep_arrays, read_arrays, spare_folder, temporary_folder
from .launch import announce, warp

ROOM = 2**26
"""Free space that a compilation needs [bytes]; LLVM ends the process where the disk is full."""

_SOURCES = (".cpp", ".cu")
_loading = threading.Lock()


@cache
def load_kernels(module: ModuleType, device: str) -> None:
    """Load a module of kernels, compiling it if necessary, before several threads use it.

    A module that this process has loaded is not looked up again: a lesson asks for it a hundred times.

    Args:
        module: A Python module with Warp kernels.
        device: ``cpu`` or a CUDA device's name.

    Raises:
        EnvironmentFailure: There is no place for temporary files, or no room on it.
    """
    wp = warp()
    # Warp names a compiled module by a hash of its content; the CPU runs blocks of one thread.
    name = wp.get_module(module.__name__).get_module_identifier(1 if device == "cpu" else None)
    with _loading, temporary_folder("kernels") as folder:
        usual = wp.config.kernel_cache_dir
        places = dict.fromkeys((Path(usual), spare_folder("kernels")))
        known = _unpack(name, places, folder / name)
        if not known:
            _check_room(folder)
            announce("compiling the kernels for this machine, once: about 20 s ...")
        wp.config.kernel_cache_dir = str(folder)
        try:
            wp.load_module(module, device=device)
        finally:
            wp.config.kernel_cache_dir = usual
        made = {file.name: file for file in (folder / name).iterdir() if file.suffix not in _SOURCES}
        if made.keys() - known:  # also where the file holds kernels of another processor only
            _keep(name, places, made)


def _unpack(name: str, places: dict[Path, None], folder: Path) -> set[str]:
    """Write the files of the first place that has them undamaged; returns their names."""
    for place in places:
        try:
            files = read_arrays(place / f"{name}.npz")
            contents = {Path(file).name: data.astype(np.uint8).tobytes() for file, data in files.items()}
        except (OSError, ValueError, TypeError):
            continue
        folder.mkdir()
        for file, content in contents.items():
            (folder / file).write_bytes(content)
        return set(contents)
    return set()


def _keep(name: str, places: dict[Path, None], made: dict[str, Path]) -> None:
    """Keep compiled files in the first place that takes them."""
    arrays = {file: np.frombuffer(path.read_bytes(), dtype=np.uint8) for file, path in made.items()}
    usual = next(iter(places))
    for place in places:
        if keep_arrays(place / f"{name}.npz", **arrays):
            if place != usual:
                announce(f"compiled kernels cannot be kept in {usual}; they are kept in {place}")
            return
    announce(f"compiled kernels can be kept neither in {usual} nor in {tempfile.gettempdir()}")


def _check_room(folder: Path) -> None:
    free = shutil.disk_usage(folder).free
    if free < ROOM:
        raise EnvironmentFailure(
            f"compiling the kernels needs {ROOM >> 20} MB in {folder.parent}, which has {free >> 20} MB; "
            "make room there, or set TMPDIR to another folder"
        )
