"""Files that hold something else than one object in metres, and objects that are long and thin.

    python -m hardening.odd_objects [--long] [--seed N] [--out out/odd_objects]

Objects are drawn by the seed: boxes, cylinders and objects of the library, turned at random. Each kind has a
right answer that is known beforehand:

- ``unit``: an object written in mm, cm or inches and read in metres is refused, and its own unit is named;
- ``apart``, ``ground``: a second body or a ground plane is refused, and part 1 of the file is the object;
- ``specks``: small pieces are left out, and the volume stays;
- ``open``: a surface without one of its faces is closed, and the volume stays;
- ``table``: a point cloud with a table is refused, and what ``cut_table`` leaves is the object's height;
- ``slender`` (long form): a rod of up to 1.5 m and 100 g is answered, and the answer holds in physics.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

from preshape.exceptions import InputError, PreshapeError
from preshape.files import write_json
from preshape.hands.load import load_hand
from preshape.objects.library import load_library_object, names
from preshape.objects.load import load_object
from preshape.objects.mesh import TriangleMesh
from preshape.planner import plan
from preshape.planning.sizes import refuse_absurd_size

from .readers import Fault

UNITS = {"mm": 1000.0, "cm": 100.0, "in": 1 / 0.0254}
"""Numbers that a file in this unit has for one metre."""
SAME_VOLUME = 0.05
"""Largest change of a volume, as a share."""

Draw = Callable[[np.random.Generator], trimesh.Trimesh]


def solid(rng: np.random.Generator) -> trimesh.Trimesh:
    """A box, a cylinder or a library object [m], turned about a random axis."""
    kind = rng.integers(3)
    if kind == 0:
        made = trimesh.creation.box(rng.uniform(0.03, 0.15, 3))
    elif kind == 1:
        made = trimesh.creation.cylinder(*rng.uniform([0.015, 0.05], [0.04, 0.2]), sections=24)
    else:
        own = load_library_object(str(rng.choice(names())))
        made = trimesh.Trimesh(own.vertices, own.triangles)
    return made.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))


def unit(rng: np.random.Generator, folder: Path) -> None:
    """An object in another unit."""
    name, factor = list(UNITS.items())[rng.integers(3)]
    mesh = solid(rng)
    extents = mesh.extents
    file = folder / "unit.stl"
    mesh.apply_scale(factor).export(file)
    said = refusal(lambda: refuse_absurd_size(load_object(file), load_hand("shadow")))
    if not said:
        # In centimetres a thin object of a few millimetres may still be one that a hand grasps in metres.
        if name == "mm" or extents.min() * factor > 3 * 0.18:
            raise Fault(f"{extents.round(3)} m in {name} was taken for metres")
    elif f"--unit {name}" not in said:
        raise Fault(f"{extents.round(3)} m in {name}: {said}")


def apart(rng: np.random.Generator, folder: Path) -> None:
    """A second, smaller body beside the object."""
    mesh, other = solid(rng), solid(rng)
    other.apply_scale(0.6 * mesh.extents.max() / other.extents.max())
    gap = rng.uniform(0.1, 1.0) * mesh.extents.max()
    other.apply_translation([mesh.bounds[1, 0] + gap - other.bounds[0, 0], 0, 0])
    chosen(folder / "apart.obj", mesh, other, "bodies that lie apart")


def ground(rng: np.random.Generator, folder: Path) -> None:
    """A ground plane under the object."""
    mesh = solid(rng)
    wide = rng.uniform(3.0, 8.0) * mesh.extents.max()
    plane = trimesh.creation.box([wide, wide, 1e-6])
    plane.apply_translation([*mesh.centroid[:2], mesh.bounds[0, 2]])
    chosen(folder / "ground.obj", mesh, plane, "a flat plate")


def specks(rng: np.random.Generator, folder: Path) -> None:
    """Small pieces around the object."""
    mesh = solid(rng)
    size = mesh.extents.max()
    parts = [mesh]
    for _ in range(rng.integers(1, 6)):
        ball = trimesh.creation.icosphere(1, 0.01 * size)
        way = rng.normal(size=3)
        parts.append(ball.apply_translation(mesh.centroid + way / np.linalg.norm(way) * size))
    file = folder / "specks.obj"
    trimesh.util.concatenate(parts).export(file)
    made = load_object(file)
    same_volume(made, mesh)
    if not any("left out" in note for note in made.notes):
        raise Fault(f"it is not said that specks are left out: {made.notes}")


def opened(rng: np.random.Generator, folder: Path) -> None:
    """A box or a cylinder without one of its flat faces."""
    size = rng.uniform(0.03, 0.12, 3)
    whole = trimesh.creation.box(size) if rng.integers(2) else trimesh.creation.cylinder(size[0] / 2, size[1])
    lid = np.all(np.isclose(whole.face_normals, [0, 0, 1]), axis=1)
    file = folder / "open.ply"
    trimesh.Trimesh(whole.vertices, whole.faces[~lid], process=False).export(file)
    made = load_object(file)
    same_volume(made, whole)
    if not any("closed by flat lids" in note for note in made.notes):
        raise Fault(f"it is not said that the surface was closed: {made.notes}")


def table(rng: np.random.Generator, folder: Path) -> None:
    """The points of an object and of the table that it stands on."""
    mesh = solid(rng)
    mesh.apply_translation([0, 0, -mesh.bounds[0, 2]])
    own = trimesh.sample.sample_surface(mesh, 4000, seed=int(rng.integers(2**31)))[0]
    wide = rng.uniform(3.0, 5.0) * mesh.extents.max()
    flat = np.column_stack([rng.uniform(-wide / 2, wide / 2, (16000, 2)), np.zeros(16000)])
    points = np.concatenate([own[own[:, 2] > 0.003], flat]) + rng.normal(0, 5e-4, (1, 3))
    file = folder / "table.npy"
    np.save(file, points)
    said = refusal(lambda: load_object(file, view="all"))
    if "--cut-table" not in said:
        raise Fault(f"the table was not named: {said or 'it was read'}")
    made = load_object(file, view="all", cut_table=True)
    if abs(made.extents[2] - mesh.extents[2]) > 0.01 + 0.1 * mesh.extents[2]:
        raise Fault(
            f"height {made.extents[2]:.3f} m after the table was cut off, {mesh.extents[2]:.3f} m before"
        )


def slender(rng: np.random.Generator, folder: Path) -> None:
    """A rod of 100 g; planned and tested in physics."""
    length, width = rng.uniform(0.1, 1.5), rng.uniform(0.012, 0.03)
    file = folder / "rod.stl"
    trimesh.creation.cylinder(width / 2, length, sections=24).export(file)
    hand = str(rng.choice(["shadow", "allegro", "leap"]))
    made = plan(file, "lift", hand=hand, mass=0.1, table=None, memory=":memory:", verify=True)
    if made.answer is None or made.verified is None or not made.verified.held:
        raise Fault(f"{hand}, {1000 * length:.0f} × {1000 * width:.0f} mm: {made.decision.reason}")


def chosen(file: Path, mesh: trimesh.Trimesh, other: trimesh.Trimesh, words: str) -> None:
    """A file with two bodies is refused by name, and one of its parts is the object."""
    trimesh.util.concatenate([mesh, other]).export(file)
    said = refusal(lambda: load_object(file))
    if words not in said or "--part-of-file" not in said:
        raise Fault(f"expected {words!r}: {said or 'it was read'}")
    same_volume(load_object(f"{file}#1"), mesh)


def same_volume(made: TriangleMesh, mesh: trimesh.Trimesh) -> None:
    """Raise a fault if the volumes differ."""
    if abs(made.volume - mesh.volume) > SAME_VOLUME * mesh.volume:
        raise Fault(f"volume {1e6 * made.volume:.1f} cm³, expected {1e6 * mesh.volume:.1f} cm³")


def refusal(attempt: Callable[[], object]) -> str:
    """The sentence with which something was refused; empty if it was not."""
    try:
        attempt()
    except InputError as error:
        return str(error)
    return ""


KINDS = {
    "unit": unit,
    "apart": apart,
    "ground": ground,
    "specks": specks,
    "open": opened,
    "table": table,
    "slender": slender,
}


def one(kind: str, number: int, seed: int) -> str:
    """Try one object of a kind; returns what went wrong, or an empty text."""
    rng = np.random.default_rng([seed, number])
    with tempfile.TemporaryDirectory() as folder:
        try:
            KINDS[kind](rng, Path(folder))
        except (Fault, PreshapeError) as error:
            return str(error)
    return ""


def main(arguments: list[str]) -> int:
    """Run from the command line; returns 0 if every object got its right answer, else 1."""
    parser = argparse.ArgumentParser(prog="python -m hardening.odd_objects", description="Odd objects.")
    parser.add_argument(
        "--long", action="store_true", help="100 objects of each kind, and 30 rods in physics"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of all draws (default: %(default)s)")
    parser.add_argument(
        "--out", type=Path, default=Path("out/odd_objects"), help="folder (default: %(default)s)"
    )
    given = parser.parse_args(arguments)
    counts = dict.fromkeys(KINDS, 100 if given.long else 8) | {"slender": 30 if given.long else 0}
    rows = []
    for kind, count in counts.items():
        wrong = 0
        for number in range(count):
            fault = one(kind, number, given.seed)
            wrong += bool(fault)
            rows.append({"kind": kind, "number": number, "fault": fault})
            if fault:
                print(f"{kind} {number}: {fault}", flush=True)
        if count:
            print(f"{kind}: {count - wrong} of {count} right", flush=True)
    write_json(given.out / "odd_objects.json", rows)
    return int(any(row["fault"] for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
