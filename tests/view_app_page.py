"""A page of the browser app as a person uses it, for the tests."""

from __future__ import annotations

import contextlib
import os
import re
import time
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlparse

import pytest
from playwright.sync_api import TimeoutError as NotInTime

PATIENCE = 90_000.0
SOON = 8_000.0
SMALL = {"width": 640, "height": 360}
"""Software rendering takes its time for every pixel."""
NO_NOTICE = """addEventListener('DOMContentLoaded', () => {
  const style = document.createElement('style');
  style.textContent = '#webgl-software-rendering { display: none }';
  document.head.append(style);
})"""
"""The notice that software draws the scene is this machine's, and covers what a test presses."""
FEW_FRAMES = """
window.requestAnimationFrame = draw => setTimeout(() => draw(performance.now()), 150);
window.cancelAnimationFrame = clearTimeout;
"""
"""Software takes tens of milliseconds of processor time for a frame, and no test needs 60 a second."""
HARMLESS = ("GPU stall", "GL Driver Message", "THREE.Clock", "KHR_parallel_shader_compile")


class Watched:
    """A page, everything it asked for, and everything it complained about."""

    def __init__(self, context) -> None:
        self.page = context.new_page()
        self.page.set_default_timeout(PATIENCE)
        self.page.add_init_script(NO_NOTICE)
        self.page.add_init_script(FEW_FRAMES)
        self.asked: list[str] = []
        self.complaints: list[str] = []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("websocket", lambda socket: self.asked.append(socket.url))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", self._heard)

    def _heard(self, message) -> None:
        if message.type in ("error", "warning") and not any(h in message.text for h in HARMLESS):
            self.complaints.append(message.text)

    def strangers(self) -> list[str]:
        """Addresses outside this machine."""
        local = {"localhost", "127.0.0.1"}
        named = [(url, urlparse(url)) for url in self.asked]
        return [u for u, p in named if p.scheme not in ("data", "blob", "file") and p.hostname not in local]


def saw(page, words: str) -> None:
    try:
        page.get_by_text(words).locator("visible=true").first.wait_for()
    except NotInTime:
        said = page.locator("body").inner_text()[:1500]
        pytest.fail(f"{words!r} was not seen; the page says:\n{said}", pytrace=False)


def press(page, name: str) -> None:
    page.get_by_role("button", name=name, exact=True).click()


def tab(page, name: str) -> None:
    page.get_by_role("tab", name=name, exact=True).click()


def planned(page) -> None:
    """Wait for a plan that the page makes by itself."""
    page.locator(".ps .head b", has_text=re.compile("^[✓✕?!] ")).first.wait_for()
    page.get_by_role("button", name="Cancel").wait_for(state="hidden")


def plan(page) -> None:
    """Plan, and wait until every answer has come."""
    press(page, "Plan")
    with contextlib.suppress(NotInTime):  # an answer may come and be drawn before anyone sees it
        page.get_by_role("button", name="Cancel").wait_for(timeout=SOON)
    page.get_by_role("button", name="Cancel").wait_for(state="hidden")


def choose(page, label: str, option: str) -> None:
    page.get_by_label(label, exact=True).first.click()
    page.get_by_role("option", name=option, exact=True).first.click()


def box_beside(page, label: str):
    """The text box of a widget."""
    row = page.locator(f"div:has(> div > p > label:text-is('{label}'))")
    return row.locator("input:not([type=hidden])").last


def set_number(page, label: str, number: str) -> None:
    """Type into the box beside a slider."""
    box = box_beside(page, label)
    box.fill(number)
    box.press("Enter")


def until(page, true: Callable[[], bool]) -> None:
    """Wait for something that the page cannot be asked to wait for."""
    end = time.monotonic() + PATIENCE / 1000
    while not true():
        assert time.monotonic() < end
        page.wait_for_timeout(100)


def place_of(page, locator) -> dict[str, float]:
    """Box of an element, as soon as it is drawn and at rest: what is drawn anew has no place for a moment."""
    boxes = [locator.bounding_box()]

    def at_rest() -> bool:
        boxes.append(locator.bounding_box())
        return boxes[-1] is not None and boxes[-1] == boxes[-2]

    until(page, at_rest)
    return boxes[-1]


def middle_of(page, locator) -> tuple[float, float]:
    """Where to press to meet the middle of an element."""
    box = place_of(page, locator)
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def in_sight(page, locator) -> None:
    """Check that an element lies in the window as a whole, and that nothing is wider than the window."""
    box, window = place_of(page, locator), page.viewport_size
    assert box["x"] >= 0
    assert box["y"] >= 0
    assert box["x"] + box["width"] <= window["width"]
    assert box["y"] + box["height"] <= window["height"]
    assert page.evaluate("document.documentElement.scrollWidth") <= window["width"]


def answer_buttons(page) -> list[str]:
    found = page.get_by_role("button", name=re.compile(r"^\d · plane"))
    found.first.wait_for()
    return found.all_text_contents()


def planners(folder: Path) -> list[int]:
    """The planner processes of the app whose temporary files lie in a folder."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            mine = f"TMPDIR={folder}".encode() in (process / "environ").read_bytes().split(b"\0")
            if mine and b"preshape.app.worker" in (process / "cmdline").read_bytes():
                found.append(int(process.name))
    return found


def keep(page, name: str, size: tuple[int, int] = (1280, 800)) -> None:
    """A screenshot in the folder that PRESHAPE_SCREENSHOTS names; software rendering makes it slow."""
    folder = os.environ.get("PRESHAPE_SCREENSHOTS")
    if folder:
        before = page.viewport_size
        page.set_viewport_size({"width": size[0], "height": size[1]})
        time.sleep(1.5)
        page.screenshot(path=Path(folder) / f"{name}.png")
        page.set_viewport_size(before)
