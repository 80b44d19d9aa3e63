"""What the tests of the browser app share: a browser that watches its page, and an app of its own to each."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from view_app_page import SMALL, Watched, planned, saw

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = [
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-rasterization",  # the software renderer draws the 3D only
    "--disable-gpu-compositing",
    "--no-sandbox",
]
SERVE = "import sys; from preshape.cli.view import view; view(sys.argv[1:], standalone_mode=False)"


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    """Headless Chromium."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        pytest.fail("the browser tests need Playwright: pip install -e '.[dev]'", pytrace=False)
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        pytest.fail("the browser tests need Chromium: on Debian, apt-get install chromium", pytrace=False)
    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=program, args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., str]]:
    """Starts `preshape view` as a process of its own and gives its address; none may say a traceback."""
    started: list[tuple[subprocess.Popen, threading.Thread, list[str]]] = []

    def start(thing: str, *more: str) -> str:
        memory = str(tmp_path / "memory.sqlite")
        hand = () if "--hand" in more or thing.endswith("plan.json") else ("--hand", "utah_mit")
        arguments = [thing, "--port", "0", "--memory", memory, *hand, *more]
        process = subprocess.Popen(
            [sys.executable, "-c", SERVE, *arguments],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "TMPDIR": str(tmp_path), "OPENBLAS_NUM_THREADS": "1"},
        )
        said = process.stderr.readline()
        found = re.search(r"http://\S+", said)
        assert found, said + process.stderr.read()
        rest: list[str] = []
        reader = threading.Thread(target=lambda: rest.extend(process.stderr), daemon=True)
        reader.start()
        started.append((process, reader, rest))
        return found[0]

    yield start
    for process, reader, rest in started:
        process.terminate()
        process.wait(timeout=20)
        reader.join(timeout=5)
        process.stderr.close()
        assert not [line for line in rest if "Traceback" in line or "exception" in line.lower()], rest


@pytest.fixture
def opened(browser, serve) -> Iterator[Callable[..., Watched]]:
    """Opens a new app in a new page and waits for its object, with ``--task`` for its plan.

    At the end nothing complained and nothing left the machine.
    """
    watched: list[Watched] = []

    def go(thing: str, *more: str, size: dict[str, int] = SMALL) -> Watched:
        context = browser.new_context(viewport=size, accept_downloads=True)
        one = Watched(context)
        watched.append(one)
        one.page.goto(serve(thing, *more))
        if "--task" in more:
            planned(one.page)
        else:
            saw(one.page, "triangles. Press Plan.")
        return one

    yield go
    for one in watched:
        assert one.complaints == []
        assert one.asked
        assert one.strangers() == []
        one.page.context.close()
