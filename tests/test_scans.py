"""Real scans: 24 objects with seams, holes and many normals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from preshape.objects.load import load_object
from preshape.types import Attributes

# Largest extent in millimetres, measured on the files by another program (awk); real baseballs are 73-75.
LENGTHS = {
    "a_lego_duplo": 64, "apple": 75, "banana": 178, "baseball": 74, "bowl": 161, "cracker_box": 213,
    "foam_brick": 78, "hammer": 333, "large_clamp": 171, "large_marker": 121, "lemon": 61,
    "master_chef_can": 140, "mug": 117, "mustard_bottle": 191, "padlock": 68, "phillips_screwdriver": 195,
    "pitcher_base": 242, "power_drill": 188, "pudding_box": 138, "scissors": 202, "spatula": 306,
    "tennis_ball": 67, "tuna_fish_can": 86, "wood_block": 206,
}  # fmt: skip


def lines(path: Path, word: str) -> list[list[str]]:
    split = (line.split() for line in path.read_text().splitlines())
    return [row[1:] for row in split if row[:1] == [word]]


def test_none_is_missing(reference: Path) -> None:
    files = {path.stem for path in (reference / "ycb").glob("*.obj")}
    assert files == set(LENGTHS)
    assert set(json.loads((reference / "ycb" / "mass_kg.json").read_text())) <= files


@pytest.mark.parametrize("name", LENGTHS)
def test_scan(reference: Path, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    """The scan equals a simple line-by-line reading of the same file."""
    path = reference / "ycb" / f"{name}.obj"
    mesh = load_object(path)
    assert capfd.readouterr() == ("", "")
    assert mesh.name == name

    points = np.array(lines(path, "v"), dtype=float)
    faces = np.array([[int(word.split("/")[0]) - 1 for word in row] for row in lines(path, "f")])
    assert mesh.counts == (len(points), len(lines(path, "vn")), len(faces), len(faces))
    corners = points[faces]
    np.testing.assert_array_equal(mesh.bounds, [corners.min(axis=(0, 1)), corners.max(axis=(0, 1))])
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert mesh.area == pytest.approx(np.linalg.norm(crosses, axis=1).sum() / 2, rel=1e-12)
    # Only triangles without area or given twice are left out, and they are few.
    assert 0 <= len(faces) - len(mesh.triangles) <= 10
    assert (mesh.areas > 0).all()
    assert set(np.unique(mesh.triangles)) == set(range(len(mesh.vertices)))

    assert 1000 * mesh.extents.max() == pytest.approx(LENGTHS[name], abs=1)
    box = float(np.prod(mesh.extents))
    assert 0.02 * box < mesh.volume < box  # outward, and within its box
    attributes = mesh.attributes
    assert isinstance(attributes, Attributes)
    assert (attributes.vertices, attributes.vertex_normals) == mesh.counts[:2]
    assert (attributes.faces, attributes.triangles) == mesh.counts[2:]
