"""What the browser app is made of, without a browser: labels, cameras, colours, curves, words, requests."""

from __future__ import annotations

import contextlib
import itertools
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from preshape.app.curves import coefficient_svg, membership_svg
from preshape.app.panel import ALTERNATIVES, AT_HEIGHT, UNDER, Panel
from preshape.app.steering import Steering, motion_words
from preshape.app.tuning import _four_numbers
from preshape.app.wire_format import decoded, encoded
from preshape.app.worker import Worker
from preshape.exceptions import InputError
from preshape.hiis.critic import Thresholds
from preshape.hiis.decision import Settings
from preshape.hiis.fuzzy import FuzzySets
from preshape.objects.load import load_object
from preshape.pictures import light_mesh
from preshape.planning.request import PlanRequest
from preshape.spatial import pose, rotation_from_vector
from preshape.types import ContactCoefficients
from preshape.viewer import colours
from preshape.viewer.camera import Camera, project
from preshape.viewer.framing import above
from preshape.viewer.labels import LINE_HEIGHT, overlapping_labels
from preshape.viewer.reduce import MAX_TRIANGLES

CAMERA = Camera(eye=[0.0, -1.0, 0.0], target=[0.0, 0.0, 0.0], up=[0.0, 0.0, 1.0], fov=40.0)

DEUTERANOPIA = np.array(
    [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
)
PROTANOPIA = np.array(
    [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
)
"""Machado, Oliveira and Fernandes 2009, severity 1; on linear sRGB."""


def test_labels_that_overlap_give_way_to_more_important_ones() -> None:
    here = np.zeros(3)
    labels = {
        "planes/3/number": ("3", here),
        "contacts/0-thumb/name": ("thumb", np.array([0.001, 0, 0])),
        "axes/a-name": ("approach", np.array([0.002, 0, 0.001])),
        "task/name": ("task", np.array([0.2, 0, 0.2])),
    }
    assert overlapping_labels(labels, CAMERA, (800, 600)) == {"planes/3/number", "axes/a-name"}
    assert overlapping_labels({}, CAMERA, (800, 600)) == set()


def test_labels_that_stay_never_overlap_and_none_goes_for_nothing() -> None:
    random = np.random.default_rng(3)
    labels = {f"planes/{i}/number": (f"word {i}", random.uniform(-0.25, 0.25, 3)) for i in range(60)}
    gone = overlapping_labels(labels, CAMERA, (800, 600))
    assert 0 < len(gone) < 60
    boxes = {}
    for name, (text, at) in labels.items():
        x, y = project(CAMERA, at[None], (800, 600))[0]
        half = len(text) * 3.3 + 4
        boxes[name] = (x - half, x + half, y - LINE_HEIGHT / 2, y + LINE_HEIGHT / 2)

    def overlap(a: str, b: str) -> bool:
        p, q = boxes[a], boxes[b]
        return p[0] < q[1] and q[0] < p[1] and p[2] < q[3] and q[2] < p[3]

    kept = [name for name in labels if name not in gone]
    assert not any(overlap(a, b) for a, b in itertools.combinations(kept, 2))
    assert all(any(overlap(name, other) for other in kept) for name in gone)


@pytest.mark.parametrize("covered", [0.0, 0.3, 0.45])
def test_a_phone_shows_the_same_above_its_panel(covered: float) -> None:
    # exactly so for what is as far away as the target; the rest follows the perspective of a higher eye
    points = np.random.default_rng(1).uniform(-0.15, 0.15, (20, 3)) * [1, 0, 1]
    wide, high = 390, 800
    seen = (wide, round(high * (1 - covered)))
    camera = Camera(eye=[0.0, -1.0, 0.0], target=[0.0, 0.0, 0.0], up=[0.0, 0.0, 1.0], fov=40.0)
    alone = project(camera, points, seen)
    whole = project(above(camera, covered), points, (wide, high))
    assert np.allclose(alone, whole, atol=1e-6)
    assert whole[:, 1].max() < seen[1]


def lab(colour: colours.Colour, see: np.ndarray) -> np.ndarray:
    """CIELAB (D65) of an sRGB colour, seen through a matrix on linear light."""
    c = np.array(colour)
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    linear = np.clip(see @ linear, 0, 1)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ linear
    f = xyz / [0.95047, 1.0, 1.08883]
    f = np.where(f > (6 / 29) ** 3, np.cbrt(f), f / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("see", [np.eye(3), DEUTERANOPIA, PROTANOPIA], ids=["all", "deutan", "protan"])
@pytest.mark.parametrize(
    "together",
    [
        {"approach": colours.APPROACH, "opposition": colours.OPPOSITION, "transverse": colours.TRANSVERSE},
        {"task": colours.TASK, "net wrench": colours.WRENCH},
        {"good": colours.GREEN, "warn": colours.ORANGE, "bad": colours.VERMILION},
        {"object": colours.OBJECT, "hand": colours.HAND, "approach": colours.APPROACH},
        dict(colours.FINGERS),
    ],
    ids=["axes", "bars", "verdicts", "solids", "fingers"],
)
def test_colours_that_stand_together_are_told_apart_by_colour_blind_people(together, see) -> None:
    seen = {name: lab(colour, see) for name, colour in together.items()}
    for a, b in itertools.combinations(seen, 2):
        assert np.linalg.norm(seen[a] - seen[b]) > 15, (a, b)


def test_the_curve_s_points_stand_where_the_corners_are() -> None:
    sets = FuzzySets().changed({"FWD-L": [0.0, 0.2, 0.3, 0.6]})
    svg = membership_svg(sets, 4)
    places = [float(x) for x in re.findall(r'<circle data-i="\d" cx="([\d.]+)"', svg)]
    lines = re.findall(r'<polyline points="([^"]+)"', svg)
    assert len(lines) == 7
    chosen = np.array([[float(n) for n in point.split(",")] for point in lines[-1].split()])
    floor, top = chosen[:, 1].max(), chosen[:, 1].min()
    assert np.allclose(np.interp(places, chosen[:, 0], chosen[:, 1]), [floor, top, top, floor], atol=0.3)
    scale = (places[3] - places[0]) / 0.6
    assert np.allclose(np.diff(places), scale * np.array([0.2, 0.1, 0.3]), atol=0.3)


def test_a_coefficient_s_line_ends_at_its_height() -> None:
    def heights(coefficients: ContactCoefficients) -> list[float]:
        svg = coefficient_svg(coefficients, 1.5)
        return [float(y) for y in re.findall(r'<circle data-i="\d" cx="\S+" cy="([\d.]+)"', svg)]

    low = heights(ContactCoefficients(ka=0.0, ko=0.0, kn=0.0, mn=0.0))
    high = heights(ContactCoefficients(ka=1.5, ko=0.75, kn=0.375, mn=0.0))
    rise = np.subtract(low, high)
    assert np.allclose(rise / rise[0], [1, 0.5, 0.25, 0], atol=0.01)


@pytest.mark.parametrize("text", ["", "1 2 3", "a b c d", "0 0 0 nan", "0 0 0 9", "1 2 3 4 5"])
def test_half_typed_numbers_change_nothing(text: str) -> None:
    assert _four_numbers(text, -1.2, 1.2) is None


def test_a_displacement_in_words() -> None:
    moved = pose(rotation_from_vector(np.array([0.0, 0.0, np.pi / 6])), [0.05, 0.0, -0.001])
    assert motion_words(moved) == "T = (50, 0, -1) mm · R = 30° about (0.00, 0.00, 1.00)"


class Gui:
    """Stands for a browser's panel: each widget is a namespace with its value."""

    def __init__(self) -> None:
        self.folders: list[str] = []

    def __getattr__(self, name: str):
        def add(*args, initial_value=None, **rest) -> SimpleNamespace:
            value = initial_value
            if value is None and name in ("add_text", "add_number", "add_checkbox"):
                value = args[1]
            if value is None and name == "add_slider":
                value = args[4]
            if value is None and name == "add_dropdown":
                value = args[1][0]
            made = {"value": value, "options": args[1] if name == "add_dropdown" else (), "content": ""}
            return SimpleNamespace(**made, disabled=False, visible=rest.get("visible", True))

        return add

    @contextlib.contextmanager
    def add_folder(self, name: str, **_):
        self.folders.append(name)
        yield

    def add_tab_group(self) -> SimpleNamespace:
        return SimpleNamespace(add_tab=lambda _: contextlib.nullcontext())


def steering_of(request: PlanRequest) -> Steering:
    """A panel that shows a request, without a browser."""
    drawn: list = []
    stage = SimpleNamespace(
        drawn=drawn,
        show_scenery=lambda table, boxes: drawn.append((table, boxes)),
        move_gizmo=lambda _: None,
    )
    return Steering(Panel(Gui(), request, "memory"), stage)


REQUESTS = {
    "the paper's hand": {"source": "cube", "task": "1 1 .1 .05 .8 .0512"},
    "a load and a scene": {
        "source": "mug",
        "task": "pour",
        "hand": "shadow",
        "mass": 0.31,
        "friction": 0.37,
        "table": -0.0601,
        "avoid": [[0.1, 0.1, 0.1, 1 / 3, 0.2, 0.2], [-0.3, 0, 0, -0.2, 0.1, 0.1]],
        "approaches": "-z,+x",
        "learn": False,
        "gravity": [0.0, 0.6, -0.8],
        "memory": "m.sqlite",
        "settings": Settings(
            thresholds=Thresholds(estimation=2.75, recognition=4.5),
            sets=FuzzySets().changed({"ZERO": [-0.3, -0.1, 0.1, 0.3]}),
            coefficients=ContactCoefficients(ka=0.1, ko=0.2, kn=1.0, mn=0.3),
            seed=7,
        ),
    },
    "the object's own mass, tested": {
        "source": "box", "task": "lift:-x", "hand": "leap", "table": "auto", "verify": True
    },
}  # fmt: skip


@pytest.mark.parametrize("name", REQUESTS)
def test_a_panel_that_nobody_touched_asks_for_the_request_that_it_shows(name: str) -> None:
    request = PlanRequest(**REQUESTS[name])
    again = steering_of(request).request(request)
    assert again.to_json() == replace(request, count=1 + ALTERNATIVES).to_json()


def test_what_is_typed_into_the_panel_is_what_is_asked_for() -> None:
    first = PlanRequest(source="mug", task="lift", hand="shadow", mass=0.31, gravity=None, table=None)
    steering = steering_of(first)
    p = steering._panel
    p.mass.value, p.friction.value, p.task.value, p.axis.value = "  ", 0.4, "push", "+x"
    p.table.value, p.avoid.value = UNDER, "0.1 0 0, 0.2 0.1 0.1\n\n0 0 0.2 0.1 0.1 0.3"
    asked = steering.request(first)
    assert asked.mass is None
    assert asked.friction == 0.4
    assert asked.asked.label == "push:+x"
    assert np.array_equal(asked.gravity, asked.asked.gravity)
    assert asked.table == "auto"
    assert asked.avoid == ((0.1, 0, 0, 0.2, 0.1, 0.1), (0, 0, 0.2, 0.1, 0.1, 0.3))
    steering.show_load()
    assert steering._stage.drawn[-1] == ("auto", asked.avoid)
    assert not p.height.visible
    p.table.value, p.height.value, p.mass.value = AT_HEIGHT, -0.2, "1.5"
    asked = steering.request(first)
    assert (asked.table, asked.mass) == (-0.2, 1.5)
    steering.show_load()
    assert p.height.visible
    # half-typed boxes leave the scene as it is, and are explained when a plan is asked for
    before = len(steering._stage.drawn)
    p.avoid.value = "0.1 0.2"
    steering.show_load()
    assert len(steering._stage.drawn) == before
    with pytest.raises(InputError, match="six numbers"):
        steering.request(first)
    p.avoid.value, p.mass.value = "", "heavy"
    with pytest.raises(InputError, match="mass is a number of kilograms"):
        steering.request(first)
    # the paper's analyser knows no loads and no scene: the widgets say so, and nothing of them is asked for
    p.analyser.value = "rays"
    steering.show_load()
    assert p.mass.disabled
    assert p.friction.disabled
    assert p.table.disabled
    assert steering._stage.drawn[-1] == (None, ())
    asked = steering.request(first)
    assert (asked.table, asked.avoid, asked.stated_mass, asked.stated_friction) == (None, (), None, 0.6)


def test_what_is_tuned_reaches_the_planner_and_the_object_is_analysed_again(tmp_path) -> None:
    replies: list[dict] = []
    worker = Worker(replies.append)
    memory = str(tmp_path / "m.sqlite")
    usual = Settings(thresholds=Thresholds(estimation=0.5))

    def wrench(settings: Settings) -> tuple[list[float], float]:
        replies.clear()
        request = PlanRequest(
            source="cube", task="1 1 .1 .05 .8 .05", settings=settings, memory=memory, hand="utah_mit"
        )
        worker.answer({"do": "plan", "id": 1, "request": request.to_json()})
        assert replies[-1].get("done"), replies[-1]
        answer = next(reply["document"] for reply in replies if "document" in reply)
        return answer["net_wrench"], answer["tfvadi"]

    first = wrench(usual)
    assert wrench(usual) == first
    slippery = ContactCoefficients(ka=0.1, ko=0.1, kn=1.0, mn=0.1)
    assert wrench(replace(usual, coefficients=slippery))[0] != first[0]
    wide = FuzzySets().changed({"ZERO": [-0.5, -0.3, 0.3, 0.5]})
    assert wrench(replace(usual, sets=wide))[1] != first[1]
    worker.close()


def test_at_most_so_many_triangles_are_sent_and_planning_keeps_them_all(tmp_path) -> None:
    replies: list[dict] = []
    worker = Worker(replies.append)
    request = PlanRequest(source="dolphin", task="lift", memory=str(tmp_path / "m.sqlite"), hand="utah_mit")
    worker.answer({"do": "load", "id": 1, "request": request.to_json()})
    mesh = next(reply["mesh"] for reply in replies if "mesh" in reply)
    whole = load_object("dolphin")
    assert mesh["whole"] == len(whole.triangles)
    sent = decoded(mesh["triangles"], "<i8", 3)
    assert len(sent) == len(light_mesh(whole).triangles) <= MAX_TRIANGLES
    assert worker._session(request).mesh(request).triangles.shape == whole.triangles.shape
    worker.close()


def test_an_answer_is_simulated_with_its_own_mass_and_friction(tmp_path, monkeypatch) -> None:
    loads: list[tuple[float, float]] = []
    monkeypatch.setattr(
        "preshape.app.physics_run.answer_run",
        lambda hand, mesh, posed, *, friction, mass, job, progress: loads.append((mass, friction)) or {},
    )
    replies: list[dict] = []
    worker = Worker(replies.append)
    request = PlanRequest(
        source="cube", task="lift", hand="shadow", memory=str(tmp_path / "m.sqlite"), table=None
    )
    hand = {"name": "shadow", "joints": []}
    new = {"schema": 2, "mass": 0.37, "request": {"friction": 0.41}, "hand": hand}
    for answer in (new, {"hand": hand}):
        message = {"do": "simulate", "id": 1, "request": request.to_json(), "answer": answer}
        worker.answer(message)
        assert replies[-1] == {"done": True, "id": 1}
    assert loads == [(0.37, 0.41), (0.1, 0.6)]
    worker.close()


def test_arrays_survive_their_way_as_text() -> None:
    array = np.random.default_rng(0).normal(size=(5, 7))
    assert np.array_equal(decoded(encoded(array, "<f8"), "<f8", 7), array)
