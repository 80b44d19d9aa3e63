"""Steering by dragging in a real browser: the task's gizmo, curves, coefficients; and on a phone."""

from __future__ import annotations

import io
import re

import numpy as np
from PIL import Image

from preshape.app.curves import EDGE, LEFT, RIGHT, WIDE
from preshape.hiis.fuzzy import FuzzySets
from view_app_page import (
    PATIENCE,
    box_beside,
    in_sight,
    keep,
    middle_of,
    place_of,
    plan,
    press,
    saw,
    tab,
    until,
)

pytest_plugins = ("view_app_fixtures",)

UP = np.array([0x20, 0xDF, 0x80]), np.array([0x20, 0x80, 0xFF])
"""Colours of the gizmo's arrows along y and z."""


def pixels_like(page, colour: np.ndarray) -> np.ndarray:
    """(n, 2) where the scene has about this colour."""
    box = page.locator("canvas").first.bounding_box()
    picture = np.asarray(Image.open(io.BytesIO(page.screenshot(clip=box))).convert("RGB"), dtype=np.int64)
    rows, columns = np.nonzero(np.abs(picture - colour).max(axis=2) < 40)
    return np.column_stack([columns + box["x"], rows + box["y"]])


def painted(page, channel: int) -> np.ndarray:
    """(n, 2) where the scene is green (channel 1) or pink (channel 0)."""
    box = page.locator("canvas").first.bounding_box()
    picture = np.asarray(Image.open(io.BytesIO(page.screenshot(clip=box))).convert("RGB"), dtype=np.int64)
    own, other = picture[..., channel], picture[..., 1 - channel]
    rows, columns = np.nonzero(own - other > 45)
    return np.column_stack([columns + box["x"], rows + box["y"]])


def drag(page, start, end) -> None:
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*((np.array(start) + end) / 2), steps=3)
    page.mouse.move(*end, steps=3)
    page.mouse.up()


def numbers(page) -> list[float]:
    return [float(box_beside(page, name).input_value()) for name in ("Tx", "Ty", "Tz", "Rx", "Ry", "Rz")]


def test_task_and_curves_are_dragged_and_used(opened) -> None:
    page = opened("cube", "--task", ".1 .1 .1 .05 .05 .05", size={"width": 640, "height": 800}).page
    page.get_by_text("The task as six numbers").click()
    saw(page, "T = (0, 0, 0) mm · R = none")
    before = numbers(page)
    page.get_by_label("Drag the task").check()
    seen = [pixels_like(page, UP[1])]

    def drawn() -> bool:
        seen.append(pixels_like(page, UP[1]))
        return len(seen[-1]) > 30 and np.array_equal(*seen[-2:])

    until(page, drawn)
    # the arrow along z is the upper part of what is blue: its tip is pulled upwards
    blue = seen[-1]
    tip = blue[blue[:, 1] <= blue[:, 1].min() + 8].mean(axis=0)
    keep(page, "app-gizmo")
    drag(page, tip, tip - [0, 60])
    assert before == [0.1, 0.1, 0.1, 0.05, 0.05, 0.05]
    until(page, lambda: numbers(page) == [0.1, 0.1, 1.0, 0.05, 0.05, 0.05])
    assert page.get_by_label("Task", exact=True).first.input_value() == "six numbers"
    told = page.get_by_text(re.compile(r"^T = \(0, 0, \d+\) mm"))
    until(page, lambda: int(re.search(r"T = \(0, 0, (\d+)\)", told.inner_text())[1]) > 5)
    plan(page)
    assert numbers(page) == [0.1, 0.1, 1.0, 0.05, 0.05, 0.05]

    # a corner of a membership function
    tab(page, "Why")
    match = page.get_by_text(re.compile(r"of 6, 3 is enough")).inner_text()
    tab(page, "Tune")
    usual = FuzzySets()
    corners = box_beside(page, "corners")
    assert [float(c) for c in corners.input_value().split()] == usual.corners[3].tolist()
    svg = page.locator("#drag-corners")
    svg.scroll_into_view_if_needed()

    def place(number: float) -> float:
        box = place_of(page, svg)
        wide = box["width"] / WIDE
        return box["x"] + wide * (LEFT + (number + EDGE) / (2 * EDGE) * (WIDE - LEFT - RIGHT))

    handle = svg.locator("circle").nth(3)
    x, y = middle_of(page, handle)
    assert abs(x - place(0.15)) < 1.5
    drag(page, (place(0.15), y), (place(0.6), y))
    until(page, lambda: abs(float(corners.input_value().split()[3]) - 0.6) < 0.015)  # a pixel is 0.007
    saw(page, "Changed: answers no longer compare with the paper")
    # the curve follows, and a corner never passes its neighbour
    until(page, lambda: abs(middle_of(page, handle)[0] - place(0.6)) < 2.5)
    keep(page, "app-tune")
    drag(page, (place(0.6), y), (place(-0.9), y))
    until(page, lambda: corners.input_value() == "-0.15 -0.05 0.05 0.05")
    press(page, "Reset the membership functions")
    until(page, lambda: corners.input_value() == "-0.15 -0.05 0.05 0.15")
    assert page.get_by_text("Changed: answers").count() == 0

    # a contact without friction gives another net wrench
    lines = page.locator("#drag-ka-ko-kn-mn")
    lines.scroll_into_view_if_needed()
    box = place_of(page, lines)
    for i in (0, 1, 3):
        middle = middle_of(page, lines.locator("circle").nth(i))
        drag(page, middle, (middle[0], box["y"] + box["height"] * 0.9))
    coefficients = box_beside(page, "ka ko kn mn")
    until(page, lambda: coefficients.input_value() == "0 0 1 0")
    tab(page, "Plan")
    plan(page)
    tab(page, "Why")
    if page.get_by_text(re.compile(r"of 6, 3 is enough")).count():
        assert page.get_by_text(re.compile(r"of 6, 3 is enough")).inner_text() != match
    tab(page, "Tune")
    press(page, "Reset the coefficients")
    until(page, lambda: coefficients.input_value() == "0.45 0.3 1 0.8")


def test_on_a_phone_the_panel_leaves_the_scene_and_goes_away(opened) -> None:
    page = opened("mug", size={"width": 390, "height": 844}).page
    scene = page.locator("canvas").first.bounding_box()
    assert (scene["width"], scene["height"]) == (390, 844)
    sheet = page.locator('div.mantine-Paper-root[style*="position: fixed"]')
    box = sheet.bounding_box()
    assert box["width"] == 390
    assert box["y"] > 0.5 * 844
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    # no widget is cut off at the side
    for widget in page.get_by_role("tab").all():
        place = widget.bounding_box()
        assert place["x"] >= 0
        assert place["x"] + place["width"] <= 390
    # the object stands in the part that can be seen
    picture = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), dtype=np.int64)
    seen = picture[150 : int(box["y"]) - 25, 20:370]  # between a notice and the sheet's shadow
    rows = np.nonzero(seen.max(axis=2) < 235)[0]
    assert len(rows) > 4000
    assert rows.max() < len(seen) - 1
    keep(page, "app-phone", (390, 844))
    page.get_by_text("preshape", exact=True).click()
    page.wait_for_function(
        "() => document.querySelector('div.mantine-Paper-root[style*=\"position: fixed\"]')"
        ".getBoundingClientRect().height < 70",
        timeout=PATIENCE,
    )
    page.get_by_text("preshape", exact=True).click()
    until(page, lambda: abs(place_of(page, sheet)["height"] - box["height"]) < 1)  # it has come to rest
    plan(page)
    saw(page, "Grasp found")
    # verdict and picture are in sight together
    head = page.locator(".ps .head").first
    in_sight(page, head)
    assert place_of(page, head)["y"] > place_of(page, sheet)["y"]
    in_sight(page, page.get_by_role("button", name="Play the grasp"))
    keep(page, "app-phone-planned", (390, 844))


def test_parts_are_offered_kept_to_and_nothing_overlaps_at_a_laptop_s_size(opened) -> None:
    asked = ("hammer", "--hold-on", "handle", "--keep-off", "z>0.07")
    page = opened(*asked, size={"width": 1280, "height": 800}).page
    until(page, lambda: box_beside(page, "handle").input_value() == "hold here")
    assert [box_beside(page, name).input_value() for name in ("head", "face")] == ["may be touched"] * 2
    # a part that is asked for is painted; a click on it in the scene asks for its next use
    until(page, lambda: len(painted(page, 1)) > 500)
    handle = box_beside(page, "handle")
    page.mouse.click(*np.median(painted(page, 1), axis=0))
    until(page, lambda: handle.input_value() == "keep off")
    saw(page, "Keep off. Click it again")
    until(page, lambda: len(painted(page, 1)) == 0 and len(painted(page, 0)) > 500)
    keep(page, "app-parts")
    at = np.median(painted(page, 0), axis=0)
    for use in ("may be touched", "hold here"):
        page.mouse.click(*at)
        until(page, lambda use=use: handle.input_value() == use)
    plan(page)
    tab(page, "Why")
    saw(page, "hold on handle, keep off z > 0.07 (as asked)")
    scene = page.locator("canvas").first.bounding_box()
    for name in ("Plan", "Why", "Answers", "Physics", "Tune", "Memory", "Show"):
        tab(page, name)
        place = page.get_by_role("tab", name=name).bounding_box()
        assert place["x"] >= scene["x"] + scene["width"]
        assert place["x"] + place["width"] <= 1280
        widgets = page.locator("button:visible, input:visible, label:visible").all()
        boxes = [w.bounding_box() for w in widgets if w.is_visible()]
        panel = [b for b in boxes if b and b["x"] >= scene["x"] + scene["width"]]
        assert all(b["x"] + b["width"] <= 1281 for b in panel)
        keep(page, f"laptop-{name.lower()}")
    tabs = [t.bounding_box() for t in page.get_by_role("tab").all()]
    assert len({round(t["y"]) for t in tabs}) == 1  # one line of tabs
