"""What a browser that draws in software is spared: checked on the page, on plain arrays, and in a browser."""

from __future__ import annotations

import gzip
from dataclasses import replace

import numpy as np
import pytest
from websockets.datastructures import Headers
from websockets.http11 import Response

from preshape.app.page_script import with_script
from preshape.objects.library import load_library_object
from preshape.viewer.colours import OBJECT
from preshape.viewer.corners import indexed, visible_side
from preshape.viewer.raycast import Shape
from preshape.viewer.reduce import reduced
from preshape.viewer.shapes import card, object_shape, sphere
from view_app_page import until

pytest_plugins = ("view_app_fixtures",)

PAGE = b"<html><head><title>x</title></head></html>"


def _response(body: bytes, **headers: str) -> Response:
    return Response(200, "OK", Headers({"Content-Length": str(len(body)), **headers}), body)


@pytest.mark.parametrize("packed", [False, True])
def test_a_page_gets_the_script_before_its_own(packed) -> None:
    body = gzip.compress(PAGE) if packed else PAGE
    encoding = "gzip" if packed else "identity"
    given = with_script(_response(body, **{"Content-Type": "text/html", "Content-Encoding": encoding}))
    page = gzip.decompress(given.body) if packed else given.body
    before, script, after = page.partition(b"<script>")[0], page, page.rpartition(b"</script>")[2]
    assert before + after == PAGE
    assert b"antialias: false" in script
    assert given.headers.get_all("Content-Length") == [str(len(given.body))]


def test_what_is_no_page_stays_as_it_is() -> None:
    assert with_script(None) is None
    picture = _response(b"<head>", **{"Content-Type": "image/png"})
    assert with_script(picture).body == b"<head>"


def test_only_what_closes_a_volume_shows_one_side() -> None:
    ball = sphere([1.0, 2.0, 3.0], 0.1, OBJECT)
    assert visible_side(ball) == "front"
    assert visible_side(replace(ball, triangles=ball.triangles[:, ::-1])) == "back"
    assert visible_side(replace(ball, triangles=ball.triangles[1:])) == "double"
    one_turned = np.array(ball.triangles)
    one_turned[7] = one_turned[7, ::-1]
    assert visible_side(replace(ball, triangles=one_turned)) == "double"
    assert visible_side(card(np.zeros(3), [1, 0, 0], [0, 1, 0], OBJECT)) == "double"
    # a file that gives every triangle corners of its own is closed all the same
    own = Shape(
        vertices=ball.vertices[ball.triangles].reshape(-1, 3),
        triangles=np.arange(3 * len(ball.triangles)).reshape(-1, 3),
        colour=OBJECT,
    )
    assert visible_side(own) == "front"


@pytest.mark.parametrize("name", ["bowl", "plate", "wine_glass", "scissors"])
@pytest.mark.parametrize("most", [300, 2000])
def test_what_is_closed_stays_closed_when_it_is_reduced(name, most) -> None:
    mesh = load_library_object(name)
    assert visible_side(object_shape(mesh)) == "front"
    vertices, triangles = reduced(mesh.vertices, mesh.triangles, most)
    assert len(triangles) <= most
    # thin walls that fell together show a face to either side
    begin = np.concatenate([triangles[:, i] for i in range(3)])
    end = np.concatenate([triangles[:, (i + 1) % 3] for i in range(3)])
    n = len(vertices)
    assert np.array_equal(np.sort(begin * n + end), np.sort(end * n + begin))


def test_the_order_for_drawing_loses_no_triangle_and_keeps_neighbours_together() -> None:
    ball = sphere(np.zeros(3), 0.1, OBJECT)
    mixed = replace(ball, triangles=ball.triangles[np.random.default_rng(3).permutation(len(ball.triangles))])
    vertices, _, triangles = indexed(mixed)

    def said(corners) -> list:
        return sorted(corners.astype(np.float32).reshape(len(corners), 9).tolist())

    assert said(vertices[triangles]) == said(mixed.vertices[mixed.triangles])
    middles = vertices[triangles].mean(axis=1)
    steps = np.linalg.norm(np.diff(middles, axis=0), axis=1)
    apart = np.linalg.norm(np.diff(mixed.vertices[mixed.triangles].mean(axis=1), axis=0), axis=1)
    assert np.median(steps) < 0.25 * np.median(apart)


def test_software_draws_coarsely_while_the_view_moves_and_finely_at_rest(opened) -> None:
    page = opened("cube").page
    scene = page.locator("canvas[data-engine]")
    box = scene.bounding_box()
    wide, high = box["width"], box["height"]

    def share() -> float:
        # the server goes by the size that a person sees, however many samples there are
        assert scene.evaluate("c => [c.width, c.height]") == [wide, high]
        return float(scene.evaluate("c => c.getContext('webgl2').drawingBufferWidth")) / wide

    until(page, lambda: share() == pytest.approx(1.5, abs=0.02))
    assert scene.evaluate("c => c.getContext('webgl2').getContextAttributes().antialias") is False
    x, y = box["x"] + box["width"] / 2, box["y"] + 0.9 * box["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 20, y)
    until(page, lambda: share() == pytest.approx(0.6, abs=0.02))
    page.mouse.up()
    until(page, lambda: share() == pytest.approx(1.5, abs=0.02))
    page.evaluate("""() => {
      window.ratios = [];
      const settings = window.__viserTestpoints.devSettings;
      settings.subscribe(() => window.ratios.push(settings.get().fixedDpr));
    }""")
    page.mouse.wheel(0, 40)
    until(page, lambda: page.evaluate("window.ratios.slice(0, 2)") == [0.6, 1.5])
