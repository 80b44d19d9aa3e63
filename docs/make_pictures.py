"""Draw the pictures of the README and the documents with preshape itself: `make pictures`."""

from __future__ import annotations

import io
import shutil
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

import preshape
from preshape.cli.bench_planner import planner
from preshape.cli.simulate import simulate
from preshape.objects.library import load_library_object, names
from preshape.planning.hand_simulation import hand_geometry
from preshape.viewer.gallery import contact_sheet, hand_picture

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
    hand_picture(hand_geometry(hand, still, hand.posture("rest")), OUT / "utah_mit.png", size=(600, 600))
    real_hand()
    lost()
    for path in sorted(OUT.glob("*.png")):
        small(path)
        print(f"wrote {path.relative_to(OUT.parent.parent)} ({path.stat().st_size // 1024} KiB)")


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
