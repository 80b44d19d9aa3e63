"""Uses of the shape descriptor: inputs of the estimator, training, recognition, the study."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from preshape.exceptions import InputError
from preshape.hiis.critic import SAME_OBJECT, SAME_SHAPE, recognise_shape
from preshape.hiis.estimator import INPUT_COUNTS, INPUTS, decode, inputs, predict
from preshape.hiis.fuzzy import FuzzySets
from preshape.hiis.learning import experiences_of, explore, learn, training_set
from preshape.hiis.training import train
from preshape.objects.library import load_library_object, names
from preshape.objects.mesh import TriangleMesh
from preshape.objects.shape import described, shape_distance
from preshape.report import Report
from preshape.report.markdown import markdown
from preshape.studies import descriptor_study as study
from preshape.studies.descriptor_study import DESCRIPTOR
from preshape.studies.setup import Setup
from preshape.tasks import parse_task
from preshape.types import ANSWER_KIND, Attributes, Experience

SETS = FuzzySets()
U = 0.043


@pytest.fixture(scope="module")
def setup() -> Setup:
    return Setup(0, quick=True)


@pytest.fixture(scope="module")
def lessons(setup: Setup) -> tuple[Experience, ...]:
    """Two objects with two tasks each, and for each the task, the best possible task and a landmark."""
    found, system = [], setup.system()
    for name in ("cylinder", "box"):
        element = setup.prepare(system, name).element
        for task in ("lift", "turn"):
            q = parse_task(task).q
            discovery = explore(element, q, SETS, enough=3.0)
            assert discovery is not None
            found += experiences_of(element, name, q, discovery, SETS)
    return tuple(found)


def attributes(name: str, **changes: Any) -> Attributes:
    return replace(described(load_library_object(name)), **changes)


# --- inputs and training ------------------------------------------------------------------------------


def test_inputs_of_kind_shape_are_task_extents_and_descriptor() -> None:
    q, a = np.array([1.0, -1.0, 0.1, 0.05, 0.8, -20.0]), attributes("mug")
    assert a.shape is not None
    x = inputs(q, a, U, "shape")
    assert x.shape == (INPUT_COUNTS["shape"],) == (37,)
    assert x.tolist() == np.round([*q[:5], -10.0, *(a.extents / (4 * U)), *a.shape], 9).tolist()
    assert np.array_equal(inputs(q, a, U, "paper"), inputs(q, a, U))
    assert len(inputs(q, a, U)) == INPUT_COUNTS["paper"] == INPUTS
    # Meshed anew the object is the same to one kind and another to the other kind.
    finer = described(study.cut_finer(load_library_object("mug")))
    assert inputs(q, finer, U, "shape") == pytest.approx(x, abs=1e-9 + 1e-12)
    assert np.abs(inputs(q, finer, U) - inputs(q, a, U)).max() > 0.05


def test_what_cannot_be_an_input_is_refused() -> None:
    bare = load_library_object("mug").attributes
    with pytest.raises(InputError, match="need a shape descriptor"):
        inputs(np.zeros(6), replace(bare, shape=None), U, "shape")
    with pytest.raises(InputError, match="no kind of inputs 'form'; known: paper, shape"):
        inputs(np.zeros(6), bare, U, "form")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="known: paper, shape"):
        training_set([], U, kind="form")  # type: ignore[arg-type]


def test_a_lesson_carries_the_descriptor(lessons: tuple[Experience, ...]) -> None:
    for e in lessons:
        assert e.attributes.shape is not None
        expected = attributes(e.object_name).shape
        assert expected is not None
        assert e.attributes.shape.tobytes() == expected.tobytes()


def test_the_training_set_of_kind_shape(lessons: tuple[Experience, ...]) -> None:
    paper, bits = training_set(lessons, U)
    x, y = training_set(lessons, U, kind="shape")
    n = len(y)
    assert n >= 6  # landmarks are not trained on
    assert (paper.shape, x.shape) == ((n, 13), (n, 37))
    assert np.array_equal(bits, y)
    assert np.array_equal(paper[:, :9], x[:, :9])
    old = [replace(e, attributes=replace(e.attributes, shape=None)) for e in lessons]
    mixed, _ = training_set([*old[:6], *lessons[6:]], U, kind="shape")
    assert np.array_equal(mixed, training_set(lessons[6:], U, kind="shape")[0])
    assert 0 < len(mixed) < n
    nothing, none = training_set(old, U, kind="shape")
    assert (nothing.shape, none.shape) == ((0, 37), (0, 9))
    assert len(training_set(old, U)[0]) == n


def test_the_network_learns_either_kind_and_starts_afresh_at_the_other(
    lessons: tuple[Experience, ...],
) -> None:
    paper = learn(lessons, U, None)
    shape = learn(lessons, U, paper, kind="shape")
    assert (paper.w1.shape, shape.w1.shape) == ((45, 13), (45, 37))
    assert np.array_equal(shape.w1, learn(lessons, U, None, kind="shape").w1)
    for e in lessons:
        if e.kind not in ("landmark", ANSWER_KIND):  # these are not taught to the estimator
            said = decode(predict(shape, inputs(e.task, e.attributes, U, "shape")))
            assert (said.plane, said.approach_set, said.fingers) == (e.plane, e.approach_set, e.fingers)
    again = learn(lessons, U, shape, kind="shape")
    assert again.epochs == 0  # nothing new: the weights already are at the target
    with pytest.raises(InputError, match="training needs"):
        learn([], U, None, kind="shape")


def test_training_takes_any_number_of_inputs() -> None:
    rng = np.random.default_rng(0)
    for n in (1, 5, 40):
        x, y = rng.normal(size=(12, n)), rng.integers(0, 2, (12, 3)).astype(float)
        assert train(x, y).w1.shape == (45, n)


# --- recognition by shape -----------------------------------------------------------------------------


def met(name: str, lesson: Experience, **changes: Any) -> Experience:
    return replace(lesson, object_name=name, attributes=attributes(name, **changes))


@pytest.fixture(scope="module")
def library(lessons: tuple[Experience, ...]) -> list[Experience]:
    return [met(name, lessons[0]) for name in names() for _ in range(2)]


@pytest.mark.parametrize("name", names())
def test_every_library_object_cut_finer_is_recognised_and_as_itself(
    name: str, library: list[Experience]
) -> None:
    here = described(study.cut_finer(load_library_object(name)))
    found = recognise_shape(here, library)
    assert found.verdict.reward
    assert found.nearest == name
    assert found.candidates >= 2
    strangers = [e for e in library if e.object_name != name]
    assert not recognise_shape(here, strangers).verdict.reward


def test_a_cylinder_and_a_prism_of_its_extents_are_not_confused(lessons: tuple[Experience, ...]) -> None:
    cylinder, prism = load_library_object("cylinder"), load_library_object("prism")
    factors = cylinder.extents / prism.extents
    same = TriangleMesh(name="prism", vertices=prism.vertices * factors, triangles=prism.triangles)
    stored = replace(lessons[0], object_name="cylinder", attributes=described(cylinder))
    found = recognise_shape(described(same), [stored])
    assert (found.candidates, found.verdict.reward) == (1, False)
    assert "is above 0.045" in found.verdict.reason
    both = [stored, replace(stored, object_name="prism", attributes=described(same))]
    assert recognise_shape(described(same), both).nearest == "prism"


@pytest.mark.parametrize(("factor", "known"), [(1.049, True), (1.055, False), (0.952, True), (0.949, False)])
def test_the_size_must_agree_within_five_per_cent(
    factor: float, known: bool, lessons: tuple[Experience, ...]
) -> None:
    stored = met("mug", lessons[0])
    for axis in range(3):
        extents = stored.attributes.extents.copy()
        extents[axis] *= factor
        found = recognise_shape(replace(stored.attributes, extents=extents), [stored])
        assert found.verdict.reward == (abs(np.log(factor)) <= SAME_OBJECT) == known
        assert found.candidates == int(known)
        assert known or "no known object has its size" in found.verdict.reason


@pytest.mark.parametrize(("off", "known"), [(0.99, True), (1.01, False)])
def test_the_limit_of_the_distance(off: float, known: bool, lessons: tuple[Experience, ...]) -> None:
    stored = met("mug", lessons[0])
    shape = stored.attributes.shape
    assert shape is not None
    direction = np.ones(len(shape)) / np.sqrt(len(shape))
    for within in (SAME_SHAPE, 0.2):
        moved = shape + off * within * direction
        assert shape_distance(moved, shape) == pytest.approx(off * within)
        here = replace(stored.attributes, shape=moved)
        assert recognise_shape(here, [stored], within).verdict.reward == known


def test_experiences_without_a_descriptor_do_not_count_and_none_is_an_error(
    lessons: tuple[Experience, ...],
) -> None:
    stored = met("mug", lessons[0], shape=None)
    found = recognise_shape(attributes("mug"), [stored])
    assert (found.candidates, found.nearest, found.verdict.reward) == (0, None, False)
    assert recognise_shape(attributes("mug"), []).candidates == 0
    for bad, words in ((None, "got none"), (np.zeros(3), "got 3 numbers")):
        with pytest.raises(InputError, match=words):
            recognise_shape(replace(stored.attributes, shape=bad), [stored])


# --- the study ----------------------------------------------------------------------------------------


def test_the_quick_study_tells_its_story(setup: Setup, tmp_path: Path) -> None:
    labels: list[tuple[float, str]] = []
    data = DESCRIPTOR.measure(setup, tmp_path / "part", lambda f, label: labels.append((f, label)))
    fractions = [fraction for fraction, _ in labels]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert list(data["shares"]) == ["paper", "shape", "extents", "task"]
    for shares in data["shares"].values():
        for mean, low, high in shares.values():
            assert 0.0 <= low <= mean <= high <= 1.0
        assert shares["mode_0"][0] <= shares["mode_1"][0] <= data["possible"][0]
    # What does not see the triangles cannot be misled by them.
    assert data["shares"]["shape"]["recut"] == data["shares"]["shape"]["learnt"]
    gain = data["shares"]["shape"]["mode_0"][0] - data["shares"]["paper"]["mode_0"][0]
    assert data["gain_0"][0] == pytest.approx(gain)
    section = DESCRIPTOR.present(json.loads(json.dumps(data)))
    assert len(section.tables[0].rows) == 4
    assert "12 pairs of object and task, seeds 0" in section.text[0]


def test_the_study_is_the_same_every_time_and_is_written_as_markdown(setup: Setup) -> None:
    first, again = (
        study.compare(setup, objects=("cube", "box"), tasks=1, folds=2, seeds=(3,)) for _ in range(2)
    )
    assert first == again
    assert (first["objects"], first["pairs"], first["seeds"]) == (2, 2, [3])
    text = markdown(Report(title="Descriptor", chapters=(DESCRIPTOR.chapter(first),)))
    assert "task, extents, shape descriptor (37)" in text
    assert "nan" not in text


@pytest.mark.parametrize(
    "bad", [{"folds": 1}, {"folds": 7}, {"tasks": 0}, {"seeds": ()}, {"objects": ("cube",)}]
)
def test_a_study_that_cannot_be_made_is_refused(setup: Setup, bad: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="the study needs 2 or more folds"):
        study.compare(setup, **({"objects": study.QUICK_OBJECTS} | bad))


@pytest.mark.parametrize("name", ["cube", "mug"])
def test_cutting_finer_keeps_the_surface(name: str) -> None:
    thing = load_library_object(name)
    finer = study.cut_finer(thing)
    assert len(finer.triangles) == 4 * len(thing.triangles)
    assert len(finer.vertices) < 4.1 * len(thing.vertices)  # corners are shared
    assert finer.area == pytest.approx(thing.area)
    assert finer.volume == pytest.approx(thing.volume)
    assert np.array_equal(finer.bounds, thing.bounds)


def test_an_interval_comes_from_whole_objects() -> None:
    alike, low, high = study._share([0] * 50 + [1] * 50, [1.0] * 50 + [0.0] * 50)
    assert (alike, low, high) == (0.5, 0.0, 1.0)  # two objects say little
    many, low, high = study._share(list(range(100)), [1.0, 0.0] * 50)
    assert many == 0.5
    assert 0.38 < low < 0.42
    assert 0.58 < high < 0.62
