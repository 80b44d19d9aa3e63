"""Draw the pictures of the README and the documents with preshape itself: `make pictures`."""

from __future__ import annotations

import io
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.font_manager import findfont
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial import cKDTree

import preshape
from preshape.cli.bench_planner import planner
from preshape.cli.simulate import simulate
from preshape.objects.library import load_library_object, names
from preshape.objects.mesh import TriangleMesh
from preshape.planning.hand_simulation import hand_geometry
from preshape.viewer.colours import INK, PAPER, SKY_TOP, to_bytes
from preshape.viewer.gallery import portrait
from preshape.viewer.labels import FONT, wrap
from preshape.viewer.shapes import hand_shape, object_shape

VIEW = (0.62, -0.72, 0.46)
"""Direction from an object towards the eye."""
OUT = Path(__file__).parent / "pictures"
LARGEST = 200_000
"""Largest size of a picture [bytes]."""
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]


def main() -> None:
    OUT.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        saved_picture(preshape.plan("mug", "pour", memory=":memory:"), Path(name), OUT / "plan.png")
    contact_sheet(
        [(load_library_object(name), name) for name in names()], OUT / "library.png", columns=11, cell=100
    )
    hand = preshape.load_hand("utah_mit")
    still = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    shape = hand_shape(hand_geometry(hand, still, hand.posture("rest")))
    Image.fromarray(portrait(shape, (600, 600), (0.75, -0.55, 0.35))).save(OUT / "utah_mit.png")
    real_hand()
    lost()
    for path in sorted(OUT.glob("*.png")):
        small(path)
        print(f"wrote {path.relative_to(OUT.parent.parent)} ({path.stat().st_size // 1024} KiB)")


def contact_sheet(
    objects: Sequence[tuple[TriangleMesh, str]], target: Path, columns: int = 4, *, cell: int = 300
) -> None:
    """Draw a grid of objects, each with its label beneath.

    Args:
        objects: Objects and their labels.
        target: The file.
        columns: Number of pictures in a row.
        cell: Width of one picture [pixels].
    """
    columns = min(columns, len(objects))
    points = max(8.0, cell / 30)
    line = round(points * 1.9)
    texts = [wrap(label, cell * 0.9, points, lines=2) for _, label in objects]
    height = cell + line * max(len(text) for text in texts) + line // 2
    rows = -(-len(objects) // columns)
    sheet = Image.new("RGB", (columns * cell, rows * height), to_bytes(PAPER))
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.truetype(findfont(FONT), points * 100 / 72)
    for i, ((mesh, _), text) in enumerate(zip(objects, texts, strict=True)):
        x, y = i % columns * cell, i // columns * height
        sheet.paste(Image.fromarray(portrait(object_shape(mesh), (cell, cell), VIEW)), (x, y))
        draw.rectangle([x, y, x + cell - 1, y + height - 1], outline=to_bytes(SKY_TOP))
        for row, words in enumerate(text):
            at = (x + cell / 2, y + cell + line * (row + 0.75))
            draw.text(at, words, font=font, fill=to_bytes(INK), anchor="mm")
    sheet.save(target)


def saved_picture(plan: preshape.Plan, folder: Path, path: Path) -> Path:
    """Save a plan to a folder and copy its picture to ``path``; returns the plan's JSON file."""
    plan.save(folder)
    shutil.copyfile(folder / "plan.png", path)
    return folder / "plan.json"


def real_hand() -> None:
    """The Shadow hand on the mug: the plan, a run in simulated physics, and the plan in the browser app."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plan = preshape.plan("mug", "pour", hand="shadow", memory=folder / "memory.sqlite", count=3)
        file = saved_picture(plan, folder, OUT / "shadow.png")
        simulate([str(file), "--out", str(folder)], standalone_mode=False)
        shutil.copyfile(folder / "filmstrip.png", OUT / "filmstrip.png")
        app(file, folder / "memory.sqlite")


def lost() -> None:
    """The spoon that turns in the Shadow hand: a grip that docs/results.md counts as lost."""
    with tempfile.TemporaryDirectory() as name:
        planner(["spoon", "--hand", "shadow", "--seed", "1", "--out", name], standalone_mode=False)
        for picture in sorted(Path(name).glob("lost-*.png"))[:1]:
            shutil.copyfile(picture, OUT / "lost.png")


def app(file: Path, memory: Path) -> None:
    """A screenshot of the browser app with a plan, in Chromium."""
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        print("no Chromium here: docs/pictures/app.png stays as it is")
        return
    from playwright.sync_api import sync_playwright

    from preshape.app.server import ViewServer
    from preshape.cli.view import start_of_plan

    server = ViewServer(start_of_plan(file, memory=str(memory)), port=0)
    try:
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=program, args=FLAGS)
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            page.set_default_timeout(120_000)
            page.goto(server.address)
            page.get_by_text("Grasp found").first.wait_for()
            page.get_by_role("tab", name="Why").click()
            notice = page.locator(".mantine-Notification-closeButton")
            page.wait_for_timeout(6000)  # the software renderer is slow to draw the labels
            if notice.count():  # the notice that the browser draws in software
                notice.first.click()
            page.wait_for_timeout(4000)
            page.screenshot(path=OUT / "app.png")
            browser.close()
    finally:
        server.stop()


def small(path: Path) -> None:
    """Reduce the colours, then the pixels of a picture until it is small enough for a page."""
    picture = Image.open(path).convert("RGB")
    for share in (1.0, 0.85, 0.7, 0.6, 0.5):
        if path.stat().st_size <= LARGEST:
            return
        size = (round(share * picture.width), round(share * picture.height))
        scaled = picture.resize(size, Image.Resampling.LANCZOS) if share < 1 else picture
        content = io.BytesIO()
        few_colours(scaled).save(content, format="PNG", optimize=True)
        path.write_bytes(content.getvalue())


def few_colours(picture: Image.Image) -> Image.Image:
    """A picture in 256 colours, half of them frequent, half of them rare.

    The frequent colours keep smooth backgrounds smooth; the rare ones keep a thin green arrow green.
    """
    frequent = picture.quantize(128, Image.Quantize.MEDIANCUT, kmeans=2)
    rare = picture.quantize(128, Image.Quantize.MAXCOVERAGE, kmeans=2)
    palette = np.array([*frequent.getpalette(), *rare.getpalette()], dtype=np.uint8).reshape(-1, 3)
    pixels = np.asarray(picture)
    colours, place = np.unique(pixels.reshape(-1, 3), axis=0, return_inverse=True)
    nearest = cKDTree(palette.astype(float)).query(colours.astype(float))[1].astype(np.uint8)
    result = Image.fromarray(nearest[place.reshape(pixels.shape[:2])], mode="P")
    result.putpalette(palette.tobytes())
    return result


if __name__ == "__main__":
    main()
