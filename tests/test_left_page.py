"""What a page of the app leaves is kept for its return: by its number, for a while, without processes."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from hardening.server import CAMERA, SETTLED, App, packed, served, settled
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from preshape.app import left_page
from preshape.app.left_page import LeftPage, LeftPages, page_number
from preshape.app.uploads import Uploads
from preshape.planning.request import PlanRequest

PAGE = 32 * "7"


def left(uploads: Uploads) -> LeftPage:
    return LeftPage(
        request=PlanRequest(source="cube", task="lift"), object_label="cube", document=None, rays=(), shown=0,
        rejected=frozenset(), deadlock=False, work="", run=None, uploads=uploads, uploaded=(),
    )  # fmt: skip


def uploaded() -> tuple[Uploads, Path]:
    uploads = Uploads()
    uploads.begin("x.obj", 3)
    path = uploads.add(b"abc")
    assert path is not None
    return uploads, path


def test_uploads_are_deleted_with_their_last_holder() -> None:
    pages, (uploads, path) = LeftPages(2), uploaded()
    pages.keep(PAGE, left(uploads))
    again = pages.get(PAGE)
    assert again is not None
    assert again.uploads is uploads
    assert pages.get("another") is None
    pages.keep(PAGE, left(uploads.shared()))  # it was opened and left again
    again.uploads.close()
    assert path.exists()
    pages.keep("second", left(Uploads()))
    pages.keep("third", left(Uploads()))  # there is room for two: the first gives way
    assert pages.get(PAGE) is None
    assert not path.exists()
    pages.close()
    assert pages.get("third") is None


def test_a_page_is_forgotten_after_a_while(monkeypatch) -> None:
    monkeypatch.setattr(left_page, "KEPT", 0.05)
    pages, (uploads, path) = LeftPages(2), uploaded()
    pages.keep(PAGE, left(uploads))
    assert settled(lambda: not path.exists())
    assert pages.get(PAGE) is None


@pytest.mark.parametrize(
    "path", ["/", "/?page=", "/?page=7", f"/?page={PAGE}7", f"/?page={31 * '7'}g", "/?p=1"]
)
def test_a_page_without_a_proper_number_is_new(path: str) -> None:
    assert page_number(path) == ""
    assert page_number(f"/?page={PAGE}") == PAGE


def opened(app: App, page: str):
    end = time.monotonic() + SETTLED
    while True:
        line = connect(
            f"{app.address.replace('http', 'ws')}/?page={page}",
            subprotocols=[app.protocol],
            max_size=None,
            additional_headers=app.known,
        )
        try:
            line.send(packed(**CAMERA))
            line.recv(timeout=SETTLED)
            return line
        except ConnectionClosed:
            assert time.monotonic() < end
            time.sleep(0.1)


def test_a_page_that_comes_back_again_and_again_leaves_no_planner_behind() -> None:
    with served("--sessions", "1") as app:
        for wait in (0.0, 0.3, 2.0, 0.0):  # before, while and after its planner starts and its object is read
            line = opened(app, PAGE)
            time.sleep(wait)
            assert len(app.planners()) <= 1
            line.close()
        assert settled(lambda: not app.planners())
        assert not app.said
