"""The browser app: frames per second with a large object, and the time from a click to the answer."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from preshape.app.worker import Worker
from preshape.objects.mesh import TriangleMesh
from preshape.pictures import light_mesh
from preshape.planning.request import PlanRequest
from preshape.viewer.reduce import MAX_TRIANGLES

from .common import median_of, row

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
SERVE = "import sys; from preshape.cli.view import view; view(sys.argv[1:], standalone_mode=False)"
SIDE = 225
"""Size of the grid of the large object, which gives about 100 000 triangles."""
SECONDS = 6.0
"""Time for which frames are counted [s]."""
COUNT = """seconds => new Promise(done => {
  let n = 0, last = ''; const begun = performance.now(), camera = window.__viserMutable.camera;
  const step = now => {
    const view = camera.matrixWorld.elements.map(x => x.toFixed(4)).join();
    n += view !== last; last = view;
    if (now - begun < 1000 * seconds) requestAnimationFrame(step); else done(1000 * n / (now - begun));
  };
  requestAnimationFrame(step); })"""
"""Counts the frames whose view differs from that of the frame before."""


def run() -> list[dict[str, Any]]:
    rows = [click_to_answer(), reduction()]
    found = frames()
    return rows if found is None else [*rows, found]


def large_object() -> TriangleMesh:
    """A closed, wrinkled ball of about 100 000 triangles, 100 mm across."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, SIDE), np.linspace(0, np.pi, SIDE), indexing="ij")
    radius = 0.05 * (1 + 0.03 * np.sin(9 * u) * np.sin(v) ** 2 * np.sin(7 * v))
    points = np.column_stack(
        [(radius * a).ravel() for a in (np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v))]
    )
    i, j = (a.ravel() for a in np.mgrid[: SIDE - 1, : SIDE - 1])
    a, b, c, d = i * SIDE + j, i * SIDE + j + 1, (i + 1) * SIDE + j, (i + 1) * SIDE + j + 1
    faces = np.concatenate([np.column_stack([a, c, b]), np.column_stack([b, c, d])])
    return TriangleMesh(name="ball", vertices=points, triangles=faces)


def click_to_answer() -> dict[str, Any]:
    """Ask about a learned object as the app's planner process does; measures the time to the first answer."""
    with tempfile.TemporaryDirectory() as folder:
        replies: list[dict[str, Any]] = []
        worker = Worker(replies.append)
        request = PlanRequest(
            source="mug", task="pour", hand="utah_mit", memory=str(Path(folder) / "m.sqlite")
        ).to_json()
        first: list[float] = []

        def ask() -> None:
            replies.clear()
            begun = time.perf_counter()
            worker.say = lambda reply: (
                replies.append(reply),
                first.append(time.perf_counter() - begun) if "document" in reply else None,
            )
            worker.answer({"do": "plan", "id": 1, "request": request})

        ask()  # the first time it is learned
        first.clear()
        times = []
        for _ in range(5):
            first.clear()
            ask()
            times.append(first[0])
        ok = next(r["document"] for r in replies if "document" in r)["mode"] == 0
    return row("click to answer, learned mug", float(np.median(times)), "s", 1.0, None, ok)


def reduction() -> dict[str, Any]:
    mesh = large_object()
    seconds = median_of(lambda: light_mesh(mesh), 3)
    light = light_mesh(mesh)
    ok = len(light.triangles) <= MAX_TRIANGLES and bool(np.allclose(light.extents, mesh.extents, rtol=0.03))
    name = f"reduce {len(mesh.triangles)} triangles to {len(light.triangles)} for the browser"
    return row(name, seconds, "s", None, None, ok)


def frames() -> dict[str, Any] | None:
    """Frames per second while the scene with the large object is turned; ``None`` without a browser."""
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        return None
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "ball.obj"
        mesh = large_object()
        lines = [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in mesh.vertices]
        lines += [f"f {a} {b} {c}" for a, b, c in mesh.triangles + 1]
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")
        arguments = [str(file), "--task", "lift", "--port", "0", "--memory", f"{folder}/m.sqlite"]
        with subprocess.Popen(
            [sys.executable, "-c", SERVE, *arguments],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        ) as process:
            assert process.stderr is not None
            found = re.search(r"http://\S+", process.stderr.readline())
            assert found is not None
            try:
                with sync_playwright() as driver:
                    browser = driver.chromium.launch(executable_path=program, args=FLAGS)
                    page = browser.new_page(viewport={"width": 1280, "height": 800})
                    page.goto(found[0])
                    words = page.get_by_text("of them drawn").first
                    words.wait_for(timeout=120_000)
                    drawn = re.search(r"(\d+) triangles, (\d+) of them drawn", words.inner_text())
                    box = page.locator("canvas").first.bounding_box()
                    assert box is not None
                    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
                    page.wait_for_timeout(2000)
                    page.mouse.move(x, y)
                    page.mouse.down()
                    page.evaluate(f"void (window.rate = ({COUNT})({SECONDS}))")
                    end = time.monotonic() + SECONDS
                    step = 0
                    while time.monotonic() < end:  # keep turning the view
                        step += 1
                        page.mouse.move(x + 120 * np.sin(0.3 * step), y + 20 * np.cos(0.2 * step))
                    rate = float(page.evaluate("window.rate"))
                    page.mouse.up()
                    browser.close()
            finally:
                process.terminate()
    ok = drawn is not None and int(drawn[1]) > 90_000 and int(drawn[2]) <= MAX_TRIANGLES
    name = "frames/s turning 100 k triangles, 1280 × 800, software rendering"
    return row(name, rate, "fps", None, f"{os.cpu_count()} cores", ok)
