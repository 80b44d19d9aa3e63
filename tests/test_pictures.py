"""What the pictures of plans say, and that they keep their colours when they are made small."""

from __future__ import annotations

import importlib.util
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from preshape.objects.library import load_library_object
from preshape.viewer.plan_picture import PlanScene, plan_image
from preshape.viewer.words import figures

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def make_pictures():
    path = ROOT / "docs" / "make_pictures.py"
    spec = importlib.util.spec_from_file_location("make_pictures", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_grip_is_headed_by_its_quality_and_a_virtual_grasp_by_its_match() -> None:
    grip = {"quality": 5.12, "task_margin": 3.4, "hold_margin": 2.0, "forces": [[0, 0, 12.0]]}
    answer = {"tfvadi": 2.33, "stability": 2, "manipulability": 5, "contacts": [{"normal_in": [0, 0, 1]}]}
    assert figures({**answer, "grip": grip}) == [  # a TFVADI of 2.33 would look like a failure beside 3
        ("quality", "5.12", "of 6"), ("task margin", "3.4", ""), ("hold margin", "2.0", ""),
        ("press", "12", "N"),
    ]  # fmt: skip
    assert figures(answer) == [
        ("TFVADI", "2.33", "of 6"), ("stability", "2", "of 6"), ("manipulability", "5", "of 6"),
    ]  # fmt: skip


def test_the_picture_shows_the_figures_of_its_scene() -> None:
    cube = load_library_object("cube")
    scene = PlanScene(
        mesh=cube, cog=cube.cog, task_name="lift", hand_name="shadow", task=np.eye(6)[2], status="answer"
    )
    heads = [(("quality of 6", "5.12"),), (("TFVADI of 6", "5.12"),), (("quality of 6", "5.13"),)]
    drawn = {plan_image(replace(scene, figures=head), size=(700, 450)).tobytes() for head in heads}
    assert len(drawn) == 3


def test_a_contact_sheet_has_a_cell_for_each_object(make_pictures, tmp_path: Path) -> None:
    cube = load_library_object("cube")
    make_pictures.contact_sheet([(cube, "a cube")] * 3, tmp_path / "sheet.png", 2, cell=80)
    with Image.open(tmp_path / "sheet.png") as image:
        assert image.size[0] == 160
        first, second = (np.asarray(image.crop((x, 0, x + 80, 80))) for x in (0, 80))
    assert (first[1:-1, 1:-1] == second[1:-1, 1:-1]).all()


def test_few_colours_keep_a_thin_arrow_green_and_a_sky_smooth(make_pictures) -> None:
    rng = np.random.default_rng(3)
    ramp = np.linspace(200, 250, 300)[:, None, None] + np.array([0.0, 2.0, 4.0])
    noise = rng.integers(0, 60, (300, 400, 1)) * (np.arange(400)[:, None] > 150)
    picture = np.clip(ramp - noise, 0, 255).astype(np.uint8)
    rare = {10: (0, 158, 115), 20: (213, 94, 0), 30: (0, 114, 178), 40: (230, 159, 0), 50: (240, 228, 66)}
    for column, colour in rare.items():
        picture[100:200, column : column + 2] = colour
    few = make_pictures.few_colours(Image.fromarray(picture))
    assert few.mode == "P"
    error = np.abs(np.asarray(few.convert("RGB"), dtype=int) - picture).max(axis=2)
    assert error.max() <= 12
    assert error[:, 60:140].max() <= 3


@pytest.mark.parametrize("path", sorted((ROOT / "docs" / "pictures").glob("*.png")), ids=lambda p: p.name)
def test_every_picture_is_small_enough_for_a_page(path: Path, make_pictures) -> None:
    assert path.stat().st_size <= make_pictures.LARGEST


DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def test_every_picture_that_a_document_shows_is_there_and_told_in_words() -> None:
    shown = set()
    for document in DOCUMENTS:
        found = re.findall(r"!\[([^\]]*)\]\(([^)]+)\)", document.read_text(encoding="utf-8"))
        assert found or document.name != "README.md"
        for words, target in found:
            assert (document.parent / target).is_file(), f"{document.name} shows {target}"
            assert len(words.split()) >= 3
            shown.add((document.parent / target).resolve())
    assert shown == {path.resolve() for path in (ROOT / "docs" / "pictures").glob("*.png")}
