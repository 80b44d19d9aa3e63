"""Writing a picture: the whole file, or none."""

from __future__ import annotations

import io
import os
import secrets
from pathlib import Path
from typing import BinaryIO, TypeAlias

from ..exceptions import EnvironmentFailure, InputError
from .raycast import Image

Target: TypeAlias = str | os.PathLike[str] | BinaryIO
"""A path that ends in ``.png``, or a binary file open for writing."""


def check_target(target: Target) -> None:
    """Refuse early what :func:`write_png` would refuse after the work.

    Raises:
        InputError: a path that does not end in ``.png``.
        EnvironmentFailure: its directory does not exist, or something other than a file is in its place.
    """
    if not isinstance(target, (str, os.PathLike)):
        return
    path = Path(target)
    if path.suffix.lower() != ".png":
        raise InputError(f"a picture's name must end in .png, got {path.name!r}")
    if not path.parent.is_dir():
        raise EnvironmentFailure(f"cannot write {path}: there is no directory {path.parent}; make it first")
    if path.exists() and not path.is_file():
        raise EnvironmentFailure(f"cannot write {path}: something other than a file is there")


def write_png(image: Image, target: Target) -> None:
    """Write an image as PNG; a file that was there before is replaced at once or left as it was.

    Args:
        image: (h, w, 3) red, green, blue.
        target: where to.

    Raises:
        InputError: a path that does not end in ``.png``.
        EnvironmentFailure: the file cannot be written.
    """
    import PIL.Image

    check_target(target)
    buffer = io.BytesIO()
    PIL.Image.fromarray(image).save(buffer, format="PNG")
    try:
        if isinstance(target, (str, os.PathLike)):
            _replace(Path(os.path.realpath(target)), buffer.getvalue())
        else:
            target.write(buffer.getvalue())
    except OSError as error:
        name = target if isinstance(target, (str, os.PathLike)) else getattr(target, "name", "the file")
        raise EnvironmentFailure(
            f"cannot write {name}: {error.strerror or error}; choose a place that can be written"
        ) from error


def _replace(path: Path, content: bytes) -> None:
    part = path.with_name(f".preshape-{secrets.token_hex(6)}.part")
    try:
        with part.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
