"""Point clouds from PCD, XYZ and NPY files, with checks for damaged files."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...exceptions import ObjectError, shown
from ...files import MOST_OF_MESH, array_in
from ...types import Array
from .scan import RawCloud

_KINDS = {
    **{("F", 4): "<f4", ("F", 8): "<f8", ("I", 1): "<i1", ("I", 2): "<i2", ("I", 4): "<i4"},
    **{("I", 8): "<i8", ("U", 1): "<u1", ("U", 2): "<u2", ("U", 4): "<u4", ("U", 8): "<u8"},
}
_DATA = ("ascii", "binary", "binary_compressed")
_SHORT = "the file is damaged or cut short"
_COMMENT = re.compile(r"(?:#|//).*")


def read_xyz(name: str, data: bytes) -> RawCloud:
    """Read an XYZ file: lines of numbers between blanks, commas or semicolons; the first three are x, y, z.

    Lines before the first numbers (a header, or the number of points) are skipped.

    Raises:
        ObjectError: The content is binary, or a line does not hold three numbers.
    """
    if b"\0" in data:
        raise ObjectError(f"{name}: expected lines of x y z, found binary data; check the suffix")
    rows: list[list[float]] = []
    for number, line in enumerate(data.decode("utf-8-sig", "replace").splitlines(), start=1):
        words = _COMMENT.sub("", line).replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        try:
            values = [float(word) for word in words[:3]]
        except ValueError:
            values = []
        if len(values) < 3:
            if not rows:
                continue
            raise ObjectError(f"{name}: line {number} should hold x, y and z, found {shown(line.strip())}")
        rows.append(values)
    return _cloud(name, np.array(rows, dtype=np.float64).reshape(-1, 3), no_echo=False)


def read_npy(name: str, data: bytes) -> RawCloud:
    """Read an array of shape (n, 3 or more) or (h, w, 3 or more); the first three columns are x, y, z.

    Raises:
        ObjectError: The file is not an NPY file, holds pickled content, or has another shape.
    """
    try:
        array = array_in(data)
    except ValueError as error:
        raise ObjectError(
            f"{name}: expected an NPY array of numbers, this file holds none ({error!s:.80})"
        ) from error
    if array.dtype.kind not in "fiu":
        raise ObjectError(f"{name}: expected an NPY array of numbers, this file holds other data")
    if array.ndim not in (2, 3) or array.shape[-1] < 3:
        shape = " × ".join(map(str, array.shape))
        raise ObjectError(f"{name}: expected points as an array n × 3, got {shape or 'one number'}")
    return _cloud(name, array.reshape(-1, array.shape[-1])[:, :3].astype(np.float64), no_echo=True)


def read_pcd(name: str, data: bytes) -> RawCloud:
    """Read a PCD file (0.7: ascii, binary or binary_compressed); a VIEWPOINT that is not zero is the camera.

    Raises:
        ObjectError: The header is invalid, or announces more data than the file holds.
    """
    header, body = _header(name, data)
    fields = header.get("FIELDS", [])
    if not {"x", "y", "z"} <= set(fields):
        listed = shown(" ".join(fields)) if fields else "none"
        raise ObjectError(f"{name}: expected the PCD fields x, y and z, found {listed}")
    try:
        counts = [int(word) for word in header.get("COUNT", ["1"] * len(fields))]
        sizes = [int(word) for word in header["SIZE"]]
        points = int(header["POINTS"][0])
        kinds = [_KINDS[pair] for pair in zip(header["TYPE"], sizes, strict=True)]
        if points < 0 or len(kinds) != len(fields) or len(counts) != len(fields):
            raise ValueError
        if not all(1 <= count <= MOST_OF_MESH for count in counts):
            raise ValueError
    except (KeyError, ValueError, IndexError) as error:
        raise ObjectError(f"{name}: the PCD header is invalid; {_SHORT}") from error
    form = " ".join(header.get("DATA", []))
    if form not in _DATA:
        raise ObjectError(f"{name}: no PCD data format {shown(form)}; known: {', '.join(_DATA)}")
    parts = [
        (f"{place}", kind, (count,)) for place, (kind, count) in enumerate(zip(kinds, counts, strict=True))
    ]
    if form == "ascii":
        columns = _text_columns(name, body, points, counts)
    elif form == "binary":
        columns = _binary_columns(name, body, points, np.dtype(parts))
    else:
        columns = _packed_columns(name, body, points, parts)
    place = [fields.index(axis) for axis in "xyz"]
    found = np.stack([np.asarray(columns[k], dtype=np.float64) for k in place], axis=1)
    cloud = _cloud(name, found, no_echo=True)
    return RawCloud(points=cloud.points, camera=_viewpoint(name, header))


def _cloud(name: str, points: Array, *, no_echo: bool) -> RawCloud:
    check_finite(name, points, no_echo=no_echo)
    return RawCloud(points=points)


def check_finite(name: str, points: Array, *, no_echo: bool) -> None:
    """Refuse positions that are not finite.

    Args:
        name: Name of the file, for messages.
        points: (n, 3) positions.
        no_echo: Whether rows of NaN are allowed, which are pixels without an echo.

    Raises:
        ObjectError: A position is not finite; the message names the first one.
    """
    bad = ~np.isfinite(points).all(axis=1)
    if no_echo:
        bad &= ~np.isnan(points).all(axis=1)
    if bad.any():
        first = int(bad.argmax())
        raise ObjectError(
            f"{name}: {bad.sum()} of {len(points)} points are not finite, the first is point {first + 1} at "
            f"{points[first]}; remove them"
        )


def _header(name: str, data: bytes) -> tuple[dict[str, list[str]], bytes]:
    found: dict[str, list[str]] = {}
    at = 0
    while at < len(data) and "DATA" not in found:
        end = data.find(b"\n", at)
        end = len(data) if end < 0 else end
        words = data[at : min(end, at + 400)].decode("ascii", "replace").split()
        if words and not words[0].startswith("#"):
            found[words[0].upper()] = words[1:]
        at = end + 1
        if len(found) > 20:
            break
    if "DATA" not in found or "FIELDS" not in found:
        raise ObjectError(f"{name}: expected a PCD header from VERSION to DATA; this is not a PCD file")
    return found, data[at:]


def _viewpoint(name: str, header: dict[str, list[str]]) -> Array | None:
    try:
        place = np.array([float(word) for word in header.get("VIEWPOINT", ["0", "0", "0"])[:3]])
    except ValueError:
        place = np.full(3, np.nan)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ObjectError(f"{name}: VIEWPOINT in the PCD header should be seven numbers; {_SHORT}")
    return place if place.any() else None


def _text_columns(name: str, body: bytes, points: int, counts: list[int]) -> list[Array]:
    try:
        values = np.array(body.decode("ascii").split(), dtype=np.float64)
    except (UnicodeDecodeError, ValueError) as error:
        raise ObjectError(f"{name}: the PCD data should be numbers; {_SHORT}") from error
    if len(values) != points * sum(counts):
        raise ObjectError(
            f"{name}: expected {points} points of {sum(counts)} numbers, found {len(values)} in all; {_SHORT}"
        )
    rows = values.reshape(points, sum(counts))
    return [rows[:, start] for start in np.cumsum(counts) - counts]


def _binary_columns(name: str, body: bytes, points: int, kind: np.dtype[Any]) -> list[NDArray[Any]]:
    if len(body) < points * kind.itemsize:
        raise ObjectError(
            f"{name}: {points} points need {points * kind.itemsize} bytes, found {len(body)}; {_SHORT}"
        )
    table = np.frombuffer(body, dtype=kind, count=points)
    return [table[field][:, 0] for field in kind.names or ()]


def _packed_columns(
    name: str, body: bytes, points: int, parts: list[tuple[str, str, tuple[int]]]
) -> list[NDArray[Any]]:
    """The columns of compressed data: one field after another, compressed with LZF."""
    packed, size = (int.from_bytes(body[at : at + 4], "little") for at in (0, 4))
    need = points * sum(np.dtype(kind).itemsize * count for _, kind, (count,) in parts)
    plain = _lzf(body[8 : 8 + packed], need) if size == need and len(body) >= 8 + packed else b""
    if len(plain) != need:
        raise ObjectError(f"{name}: the compressed PCD data do not hold {points} points; {_SHORT}")
    columns, at = [], 0
    for _, kind, (count,) in parts:
        values = np.frombuffer(plain, dtype=kind, count=points * count, offset=at)
        columns.append(values.reshape(points, count)[:, 0])
        at += values.nbytes
    return columns


def _lzf(data: bytes, most: int) -> bytes:
    """Decompress LZF (libLZF's format): runs of plain bytes, and copies of earlier output.

    Returns:
        At most a little more than ``most`` bytes; nothing for damaged data.
    """
    out = bytearray()
    at = 0
    try:
        while at < len(data) and len(out) <= most:
            control = data[at]
            at += 1
            if control < 32:
                out += data[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += data[at]
                at += 1
            start = len(out) - ((control & 31) << 8) - data[at] - 1
            at += 1
            if start < 0:
                return b""
            for k in range(length + 2):  # a copy may overlap its own output
                out.append(out[start + k])
    except IndexError:
        return b""
    return bytes(out)
