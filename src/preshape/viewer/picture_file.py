"""Pictures as PNG files; a failure never leaves an incomplete file."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import BinaryIO, TypeAlias

from ..exceptions import EnvironmentFailure, InputError
from ..files import write_bytes
from .raycast import Image

Target: TypeAlias = str | os.PathLike[str] | BinaryIO
"""A path that ends in ``.png``, or a binary file open for writing."""


def check_target(target: Target) -> None:
    """Check a target before its picture is computed.

    Raises:
        InputError: The path does not end in ``.png``.
        EnvironmentFailure: The path's directory does not exist, or the path is not a regular file.
    """
    if not isinstance(target, (str, os.PathLike)):
        return
    path = Path(target)
    if path.suffix.lower() != ".png":
        raise InputError(f"the name of a picture must end in .png, got {path.name!r}")
    if not path.parent.is_dir():
        raise EnvironmentFailure(f"cannot write {path}: there is no directory {path.parent}; make it first")
    if path.exists() and not path.is_file():
        raise EnvironmentFailure(f"cannot write {path}: something other than a file is there")


def write_png(image: Image, target: Target) -> None:
    """Write an image as PNG; an existing file is replaced only once the new one is complete.

    Args:
        image: (h, w, 3) Red, green and blue.
        target: A path that ends in ``.png``, or a binary file open for writing.

    Raises:
        InputError: The path does not end in ``.png``.
        EnvironmentFailure: The file cannot be written.
    """
    import PIL.Image

    check_target(target)
    buffer = io.BytesIO()
    PIL.Image.fromarray(image).save(buffer, format="PNG")
    if isinstance(target, (str, os.PathLike)):
        write_bytes(Path(os.path.realpath(target)), buffer.getvalue())  # a symbolic link stays a link
        return
    try:
        target.write(buffer.getvalue())
    except OSError as error:
        name = getattr(target, "name", "the file")
        raise EnvironmentFailure(
            f"cannot write {name}: {error.strerror or error}; choose a place that can be written"
        ) from error
