"""glTF, text and binary, read by trimesh; files that trimesh would read wrongly or slowly are refused first.

trimesh cannot read triangle fans, line strips, or positions that are sparse or compressed; positions that are
normalised whole numbers are scaled by a node of our own. Skins and morphs are read in their rest state.
"""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from ..exceptions import ObjectError, shown
from ..files import MOST_OF_MESH, read_file
from ..types import LONGEST_NAME
from .read_raw import RawMesh
from .read_text import printable
from .read_trimesh import read_scene

# Limits far above any scan: numbers of all parts, of nodes, and of levels of nodes. The time that trimesh
# needs grows with the third power of the levels.
_MOST, _NODES, _LEVELS = 60_000_000, 2000, 32
_STEPS = {5120: 127, 5121: 255, 5122: 32767, 5123: 65535}
"""Number that stands for 1 in each kind of normalised whole numbers."""


def read_gltf(name: str, data: bytes, path: Path) -> RawMesh:
    """Read a glTF scene, text or binary; equal positions are counted once [C].

    Args:
        name: Name of the file, for messages.
        data: Content of the file.
        path: Path of the file, which may refer to buffers beside it.

    Raises:
        ObjectError: See :func:`preshape.objects.load.load_object`.
    """
    binary = data.startswith(b"glTF")
    start, end = (20, 20 + int.from_bytes(data[12:16], "little")) if binary else (0, len(data))
    if binary and max(end, stated := int.from_bytes(data[8:12], "little")) > len(data):
        raise ObjectError(
            f"{name}: the header promises {max(end, stated)} bytes, the file has {len(data)}; it is cut short"
        )
    tree = json.loads(data[start:end])
    _keep_triangles(name, tree)
    files = {
        uri: _beside(name, uri, path)
        for buffer in tree.get("buffers", ())
        if not (uri := buffer.get("uri", "data:")).startswith("data:")
    }
    _arrange(name, tree)
    _check(name, tree, len(data) + sum(map(len, files.values())))
    labels = _label(tree)
    text = json.dumps(tree).encode()
    if binary:
        data = data[:12] + len(text).to_bytes(4, "little") + data[16:20] + text + data[end:]
    return read_scene(name, data if binary else text, "glb" if binary else "gltf", files, labels=labels)


def _label(tree: dict[str, Any]) -> dict[str, list[str]]:
    """Give every node with triangles one primitive and a name of its own, under which trimesh returns it.

    Returns:
        For each of these names, the names in the file of the node, of the nodes above it, of the mesh and of
        the material.
    """
    nodes, meshes, materials = tree["nodes"], tree.get("meshes", []), tree.get("materials", [])
    above: dict[int, list[str]] = {}
    waiting: list[tuple[int, list[str]]] = [
        (index, []) for index in _item(tree["scenes"], tree["scene"]).get("nodes", [])
    ]
    while waiting:
        index, names = waiting.pop()
        above[index] = [*names, *_names(nodes[index])]
        waiting += [(child, above[index]) for child in nodes[index].get("children", ())]
    primitives: list[dict[str, Any]] = []
    places: list[list[int]] = []
    for mesh in meshes:
        places.append([len(primitives) + k for k in range(len(mesh["primitives"]))])
        primitives += [{**mesh, "primitives": [primitive]} for primitive in mesh["primitives"]]
    labels: dict[str, list[str]] = {}
    for index in range(len(nodes)):
        node = nodes[index]
        node["name"] = str(index)
        if "mesh" not in node:
            continue
        mesh, own = meshes[node["mesh"]], places[node.pop("mesh")]
        for k, place in enumerate(own):
            found = [*above.get(index, ()), *_names(mesh)]
            material = mesh["primitives"][k].get("material")
            if isinstance(material, int) and 0 <= material < len(materials):
                found += _names(materials[material])
            if len(own) == 1:
                node["mesh"] = place
                labels[str(index)] = list(dict.fromkeys(found))
            else:
                node.setdefault("children", []).append(len(nodes))
                labels[str(len(nodes))] = list(dict.fromkeys(found))
                nodes.append({"name": str(len(nodes)), "mesh": place})
    tree["meshes"] = primitives
    return labels


def _names(entry: dict[str, Any]) -> list[str]:
    """The name of an entry, printable; none if it has none."""
    name = entry.get("name")
    return [text] if isinstance(name, str) and (text := printable(name, LONGEST_NAME)) else []


def _beside(name: str, uri: str, path: Path) -> bytes:
    beside = Path(unquote(uri))
    if beside.is_absolute() or ".." in beside.parts or ":" in uri:
        raise ObjectError(f"{name}: refers to the buffer {shown(uri)}; only files beside it are read")
    try:
        return read_file(path.parent / beside, MOST_OF_MESH, "buffer", refusal=ObjectError)
    except OSError as error:
        raise ObjectError(
            f"{name}: its buffer {shown(uri)} cannot be read ({error.strerror}); put it beside the file"
        ) from error


def _item(entries: list[Any], index: object) -> Any:
    """An entry; a negative index is an error of the file and not the last entry."""
    if not isinstance(index, int) or not 0 <= index < len(entries):
        raise IndexError(f"no entry {shown(index)} among {len(entries)}")
    return entries[index]


def _keep_triangles(name: str, tree: dict[str, Any]) -> None:
    """Leave out empty parts, and refuse compressed ones; a file may declare compression without using it."""
    accessors, required = tree.get("accessors", []), tree.get("extensionsRequired", ())
    for view in tree.get("bufferViews", ()):
        for extension in view.get("extensions", ()):
            if "compression" in extension and extension in required:
                raise _compressed(name, extension)
    for mesh in tree.get("meshes", ()):
        kept = []
        for primitive in mesh["primitives"]:
            used = [primitive.get("attributes", {}).get("POSITION"), primitive.get("indices")]
            arrays = [_item(accessors, index) for index in used if index is not None]
            if used[0] is None or any(array["count"] == 0 for array in arrays):
                continue
            for extension in primitive.pop("extensions", ()):
                if "compression" in extension and not all("bufferView" in array for array in arrays):
                    raise _compressed(name, extension)
            kept.append(primitive)
        mesh["primitives"] = kept


def _compressed(name: str, extension: str) -> ObjectError:
    method = "with Draco " if "draco" in extension.lower() else ""
    return ObjectError(
        f"{name}: the mesh is compressed {method}({printable(extension)}), which cannot be read; "
        "export it without compression"
    )


def _dequantise(tree: dict[str, Any]) -> None:
    """Read normalised whole numbers as they are; a node around each mesh scales them to -1..1 or 0..1."""
    accessors, nodes = tree.get("accessors", []), tree["nodes"]
    quantised = []
    for mesh in tree.get("meshes", ()):
        used = [_item(accessors, primitive["attributes"]["POSITION"]) for primitive in mesh["primitives"]]
        steps = {_STEPS[array["componentType"]] if array.get("normalized") else 1 for array in used}
        if len(steps) > 1:
            raise ValueError("the parts of one mesh are quantised differently")
        quantised.append(next(iter(steps), 1))
    for accessor in accessors:
        accessor.pop("normalized", None)
    for node in [node for node in nodes if "mesh" in node]:
        if (steps := _item(quantised, node["mesh"])) > 1:
            node.setdefault("children", []).append(len(nodes))
            nodes.append({"mesh": node.pop("mesh"), "scale": [1 / steps] * 3})


def _check(name: str, tree: dict[str, Any], size: int) -> None:
    """Refuse arrays outside their buffers, and scenes that do not fit into memory."""
    views, accessors, meshes = (tree.get(kind, []) for kind in ("bufferViews", "accessors", "meshes"))
    for view in views:
        _item(tree["buffers"], view["buffer"])
    stated = [value for entry in [*views, *accessors] for value in entry.values() if isinstance(value, int)]
    if min(stated, default=0) < 0 or any(view.get("byteStride", 4) < 4 for view in views):
        raise ValueError("a buffer view or an accessor lies outside its buffer")
    uses = Counter(node["mesh"] for node in tree["nodes"] if "mesh" in node)
    for index in uses:
        _item(meshes, index)
    total = sum(accessor["count"] for accessor in accessors)
    for index, mesh in enumerate(meshes):
        for primitive in mesh["primitives"]:
            place = primitive["attributes"]["POSITION"]
            position = _item(accessors, place)
            if position["type"] != "VEC3":
                raise ValueError("positions must be three plain numbers")
            for accessor in (position, _item(accessors, primitive.get("indices", place))):
                if "sparse" in accessor or "bufferView" not in accessor:
                    raise ValueError("sparse or empty accessors cannot be read")
                _item(views, accessor["bufferView"])
                total += max(accessor["count"], 5000) * max(1, uses[index])
    if total > _MOST or sum(view["byteLength"] for view in views) > 4 * size:
        raise ObjectError(f"{name}: the scene has more than {_MOST} numbers; simplify it")


def _arrange(name: str, tree: dict[str, Any]) -> None:
    """Add a scene of all nodes if the file has no scene, and refuse nodes that do not form trees."""
    if not tree.setdefault("nodes", []):
        tree["nodes"] = [{"mesh": index} for index in range(len(tree.get("meshes", [])))]
        tree.pop("scenes", None)
    _dequantise(tree)
    nodes = tree["nodes"]
    children = Counter(child for node in nodes for child in node.get("children", ()))
    if not tree.get("scenes"):
        tree["scenes"] = [{"nodes": [index for index in range(len(nodes)) if index not in children]}]
    level = _item(tree["scenes"], tree.setdefault("scene", 0)).get("nodes", [])
    for index, parents in (children + Counter(level)).items():
        if parents > 1:
            raise ObjectError(f"{name}: scene node {shown(index)} has two parents; the file is damaged")
    levels = 0
    while level:
        level = [child for index in level for child in _item(nodes, index).get("children", ())]
        levels += 1
    if levels > _LEVELS or len(nodes) > _NODES:
        raise ObjectError(
            f"{name}: the scene has {len(nodes)} nodes in {levels} levels, "
            f"at most {_NODES} in {_LEVELS} are read; join its parts"
        )
    for node in nodes:
        node.pop("camera", None)  # trimesh would leave out its children
