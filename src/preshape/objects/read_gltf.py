"""glTF 2.0 and GLB: every triangle of every node of the scene, where its node puts it."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from ..exceptions import ObjectError
from ..types import Array, IntArray
from .read_raw import RawMesh, assemble, merge_equal

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC3": 3}
_COMPRESSIONS = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_MOST = 20_000_000


def read_gltf(name: str, data: bytes, path: Path) -> RawMesh:
    """Read a glTF scene; equal positions are counted once [C]. Skins and morphs stay at rest.

    Args:
        name: the file, for messages.
        data: its content.
        path: where it lies; a ``.gltf`` file names others beside it.

    Raises:
        ObjectError: see :func:`preshape.objects.load.load_object`.
    """
    document, binary = _chunks(name, data)
    gltf = json.loads(document)
    for extension in gltf.get("extensionsRequired", ()):
        if extension in _COMPRESSIONS:
            raise ObjectError(
                f"{name}: the mesh is compressed ({extension}), which is not read; export it without"
            )
    buffers = [_buffer(name, entry, binary, path) for entry in gltf.get("buffers", ())]
    points: list[Array] = [np.zeros((0, 3))]
    faces: list[IntArray] = [np.zeros((0, 3), dtype=np.int64)]
    vertices = triangles = 0
    for mesh, transform in _instances(name, gltf):
        for primitive in mesh["primitives"]:
            position = _accessor(gltf, buffers, primitive["attributes"]["POSITION"], 3)
            own = _triangles(gltf, buffers, primitive, len(position))
            outside = (own < 0) | (own >= len(position))
            own = np.where(outside, -1, own + vertices)  # else it would reach into another part
            mirrored = np.linalg.det(transform[:3, :3]) < 0
            points.append(position @ transform[:3, :3].T + transform[:3, 3])
            faces.append(own[:, ::-1] if mirrored else own)
            vertices, triangles = vertices + len(position), triangles + len(own)
            if max(vertices, triangles) > _MOST:
                raise ObjectError(f"{name}: the scene has over {_MOST} vertices or triangles; simplify it")
    corners = np.concatenate(faces)
    raw = assemble(name, np.concatenate(points), corners.reshape(-1), np.full(len(corners), 3))
    merged, indices = merge_equal(raw.vertices, raw.triangles)
    return RawMesh(vertices=merged, triangles=indices, normals=len(merged), faces=len(indices))


def _chunks(name: str, data: bytes) -> tuple[bytes, bytes]:
    """The JSON document and the binary that follows it."""
    if not data.startswith(b"glTF"):
        return data, b""
    _, version, length, size, kind = struct.unpack_from("<4sIII4s", data)
    if version != 2 or kind != b"JSON":
        raise ObjectError(f"{name}: expected glTF version 2, found version {version}; export it anew")
    if length > len(data) or 20 + size > length:
        raise ObjectError(
            f"{name}: the header promises {length} bytes, the file has {len(data)}; it is cut short"
        )
    binary = b""
    if 28 + size <= length:
        room, kind = struct.unpack_from("<I4s", data, 20 + size)
        if kind == b"BIN\0":
            binary = data[28 + size : 28 + size + room]
    return data[20 : 20 + size], binary


def _buffer(name: str, entry: dict[str, Any], binary: bytes, path: Path) -> bytes:
    uri = entry.get("uri")
    if uri is None:
        content = binary
    elif uri.startswith("data:"):
        content = base64.b64decode(uri.partition(",")[2], validate=True)
    else:
        beside = Path(unquote(uri))
        if beside.is_absolute() or ".." in beside.parts or ":" in uri:
            raise ObjectError(f"{name}: names the buffer {uri!r:.80}; only files beside it are read")
        try:
            content = (path.parent / beside).read_bytes()
        except OSError as error:
            raise ObjectError(
                f"{name}: its buffer {uri!r:.80} cannot be read ({error.strerror}); put it beside the file"
            ) from error
    if len(content) < entry["byteLength"]:
        raise ObjectError(
            f"{name}: a buffer of {entry['byteLength']} bytes has {len(content)}; "
            "the file is damaged or cut short"
        )
    return content


def _item(entries: list[Any], index: object) -> Any:
    """One entry; a negative index is a damaged file, not the last entry."""
    if not isinstance(index, int) or not 0 <= index < len(entries):
        raise IndexError(f"no entry {index!r:.20} among {len(entries)}")
    return entries[index]


def _accessor(gltf: dict[str, Any], buffers: list[bytes], index: object, width: int) -> NDArray[Any]:
    """(n, width) numbers, positions as float64."""
    entry = _item(gltf["accessors"], index)
    if "sparse" in entry or "bufferView" not in entry:
        raise ValueError("sparse or empty accessors are not read")
    if _WIDTHS.get(entry["type"]) != width:
        raise ValueError(f"expected {width} numbers an entry, found {entry['type']!r:.20}")
    view = _item(gltf["bufferViews"], entry["bufferView"])
    content = _item(buffers, view["buffer"])
    begin, length = view.get("byteOffset", 0), view["byteLength"]
    offset, count = entry.get("byteOffset", 0), entry["count"]
    kind = np.dtype(_COMPONENTS[entry["componentType"]])
    row = kind.itemsize * width
    stride = view.get("byteStride", row)
    if min(begin, length, offset, count) < 0 or stride < row or begin + length > len(content):
        raise ValueError("a buffer view lies outside its buffer")
    if count and offset + stride * (count - 1) + row > length:
        raise ValueError("an accessor lies outside its buffer view")
    if not count:
        return np.zeros((0, width), dtype=kind)
    found = np.ndarray((count, width), kind, content, begin + offset, (stride, kind.itemsize))
    if kind.kind != "f" and entry.get("normalized"):
        return np.maximum(found / np.iinfo(kind).max, -1.0)
    return found


def _triangles(gltf: dict[str, Any], buffers: list[bytes], primitive: dict[str, Any], count: int) -> IntArray:
    """(m, 3) indices of one primitive; none where it is made of points or lines."""
    mode = primitive.get("mode", _TRIANGLES)
    order = np.arange(count)
    if "indices" in primitive:
        order = _accessor(gltf, buffers, primitive["indices"], 1).reshape(-1).astype(np.int64)
    if mode == _TRIANGLES:
        return order.reshape(-1, 3)
    if mode == _STRIP and len(order) > 2:
        strip = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
        strip[1::2, 1:] = strip[1::2, :0:-1]  # every other one turns the other way
        return strip
    if mode == _FAN and len(order) > 2:
        return np.stack([order[1:-1], order[2:], np.full(len(order) - 2, order[0])], axis=1)
    return np.zeros((0, 3), dtype=np.int64)


def _instances(name: str, gltf: dict[str, Any]) -> list[tuple[Any, Array]]:
    """Meshes with their transforms into the scene; without a scene, all nodes; without nodes, all meshes."""
    nodes, meshes = gltf.get("nodes", []), gltf.get("meshes", [])
    if not nodes:
        return [(mesh, np.eye(4)) for mesh in meshes]
    if gltf.get("scenes"):
        roots = _item(gltf["scenes"], gltf.get("scene", 0)).get("nodes", [])
    else:
        children = {child for node in nodes for child in node.get("children", ())}
        roots = [k for k in range(len(nodes)) if k not in children]
    found: list[tuple[Any, Array]] = []
    waiting = [(root, np.eye(4)) for root in reversed(roots)]
    seen: set[int] = set()
    while waiting:
        index, above = waiting.pop()
        node = _item(nodes, index)
        if index in seen:
            raise ObjectError(f"{name}: scene node {index} has two parents; the file is damaged")
        seen.add(index)
        here = above @ _local(node)
        if "mesh" in node:
            found.append((_item(meshes, node["mesh"]), here))
        waiting += [(child, here) for child in reversed(node.get("children", []))]
    return found


def _local(node: dict[str, Any]) -> Array:
    """(4, 4) a node's transform to its parent, by a matrix or by scale, rotation (xyzw), translation."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = (float(part) for part in node.get("rotation", (0, 0, 0, 1)))
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    local = np.eye(4)
    local[:3, :3] = turn * np.array(node.get("scale", (1, 1, 1)), dtype=np.float64)
    local[:3, 3] = node.get("translation", (0, 0, 0))
    return local
