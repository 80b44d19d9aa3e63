"""The internal critic: thresholds with slack, attribute distance, recognition (mode 2)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from preshape.exceptions import InputError
from preshape.hands.load import load_hand
from preshape.hiis.analyser import Aim
from preshape.hiis.critic import SAME_OBJECT, Thresholds, judge, recognise
from preshape.hiis.fuzzy import FuzzySets, tfvadi
from preshape.hiis.learning import experiences_of, explore
from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.objects.library import load_library_object
from preshape.objects.mesh import TriangleMesh
from preshape.objects.shape import attribute_distance
from preshape.planning.controllers import layout_of
from preshape.tasks import parse_task
from preshape.types import Attributes, Experience

LAYOUT = layout_of(load_hand("utah_mit"))
SETS = FuzzySets()
BOX_TRIANGLES = [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4]]
BOX_TRIANGLES += [[2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]]
CUBE = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) / 2


def boxes(*parts, name="boxes") -> TriangleMesh:
    """Boxes (extents, centre) as one mesh."""
    vertices = np.concatenate([CUBE * np.array(extents) + centre for extents, centre in parts])
    triangles = np.concatenate([np.array(BOX_TRIANGLES) + 8 * k for k in range(len(parts))])
    return TriangleMesh(name=name, vertices=vertices, triangles=triangles)


def analyser(mesh: TriangleMesh) -> RayAnalyser:
    return RayAnalyser(mesh, LAYOUT)


def experience(pa: RayAnalyser, aim: Aim | None = None, *, name="stored", **changes) -> Experience:
    """The virtual grasp of an object that resembles itself most, as an experience."""
    found = pa.explore(np.zeros(6), aim or Aim(values=SETS.crisp()))
    own = tfvadi(found.wrench, found.wrench, SETS)
    g = found.grasp(int(np.argmax(own)))
    made = Experience(
        kind="landmark",
        object_name=name,
        hand=LAYOUT.name,
        attributes=pa.mesh.attributes,
        task=g.net_wrench,
        plane=g.plane.index,
        flip=g.flip,
        approach_value=g.approach_value,
        approach_set=g.approach_set,
        fingers=g.fingers,
        wrench=g.net_wrench,
        match=float(own.max()),
    )
    return replace(made, **changes)


@pytest.fixture(scope="module")
def box() -> RayAnalyser:
    return analyser(boxes(([0.06, 0.04, 0.05], [0, 0, 0])))


# -- thresholds and verdicts ---------------------------------------------------------------------------


@pytest.mark.parametrize("threshold", [0.0, 3.0, 5.0, 6.0])
def test_a_threshold_is_met_with_a_slack_of_1e_9_and_no_more(threshold):
    assert judge(threshold, threshold).reward
    assert judge(threshold - 0.9e-9, threshold).reward
    assert not judge(threshold - 2e-9, threshold).reward
    assert not judge(threshold - 1e-6, threshold).reward
    assert judge(threshold + 1e-6, threshold).reward


@given(st.floats(0, 6), st.floats(0, 6))
def test_the_verdict_follows_the_match(match, threshold):
    verdict = judge(match, threshold, subject="recognition")
    assert verdict.match == match
    assert verdict.reward == (match >= threshold - 1e-9)
    assert verdict.reason.startswith("recognition")
    assert f"{match:.2f}" in verdict.reason
    assert f"{threshold:.2f}" in verdict.reason


def test_without_a_virtual_grasp_there_is_a_penalty_even_at_threshold_zero():
    verdict = judge(None, 0.0)
    assert not verdict.reward
    assert verdict.match is None
    assert "no grasp found" in verdict.reason


def test_the_thresholds_of_the_paper_are_the_defaults():
    assert (Thresholds().estimation, Thresholds().recognition) == (3.0, 5.0)


@pytest.mark.parametrize("bad", [-0.1, 6.1, 7, float("nan"), float("inf"), "high"])
@pytest.mark.parametrize("which", ["estimation", "recognition"])
def test_a_threshold_that_no_match_can_be_is_refused(which, bad):
    with pytest.raises(InputError, match="thresholds"):
        Thresholds(**{which: bad})


# -- attribute distance --------------------------------------------------------------------------------

lengths = st.floats(1e-3, 1.0)
counts = st.integers(1, 1_000_000)


@st.composite
def attributes(draw) -> Attributes:
    extents = [draw(lengths) for _ in range(3)]
    w, h, d = extents
    return Attributes(
        extents=extents,
        vertices=draw(counts),
        vertex_normals=draw(counts),
        faces=draw(counts),
        triangles=draw(counts),
        area=2 * (w * h + h * d + d * w) * draw(st.floats(0.3, 3.0)),
        volume=w * h * d * draw(st.sampled_from([0.0, 1e-5, 0.1, 0.5, 1.0])),
    )


@given(attributes(), attributes())
def test_attribute_distance_is_symmetric_finite_and_not_negative(a, b):
    d = attribute_distance(a, b)
    assert d == pytest.approx(attribute_distance(b, a), rel=1e-12, abs=1e-15)
    assert np.isfinite(d)
    assert d >= 0


@given(attributes(), counts, counts)
def test_attribute_distance_is_zero_on_itself_whatever_the_counts(a, n, m):
    assert attribute_distance(a, a) == 0
    other = replace(a, vertices=n, vertex_normals=m, faces=m, triangles=n)
    assert attribute_distance(a, other) == 0


@given(attributes(), st.integers(0, 2), st.floats(1.1, 3.0))
def test_a_longer_axis_a_larger_area_and_a_larger_volume_each_count(a, axis, factor):
    longer = a.extents.copy()
    longer[axis] *= factor
    assert attribute_distance(a, replace(a, extents=longer)) >= np.log(factor) - 1e-12
    assert attribute_distance(a, replace(a, area=a.area * factor)) == pytest.approx(np.log(factor) / 2)
    if a.volume > 2e-3 * np.prod(a.extents):
        assert attribute_distance(a, replace(a, volume=a.volume / factor)) == pytest.approx(
            np.log(factor) / 3
        )


def test_a_body_and_an_open_sheet_of_the_same_size_are_far_apart_and_two_sheets_are_not():
    body = analyser(boxes(([0.06, 0.04, 0.05], [0, 0, 0]))).mesh.attributes
    sheet = replace(body, volume=0.0)
    assert attribute_distance(body, sheet) > 1
    assert attribute_distance(sheet, replace(sheet, volume=1e-6 * float(np.prod(body.extents)))) == 0


def test_a_turned_object_is_another_one():
    lying, upright = (boxes((extents, [0, 0, 0])) for extents in ([0.09, 0.04, 0.05], [0.05, 0.04, 0.09]))
    assert attribute_distance(lying.attributes, upright.attributes) == pytest.approx(np.log(9 / 5))


# -- recognition ---------------------------------------------------------------------------------------


def test_an_object_is_recognised_as_itself_with_the_match_of_its_wrench_with_itself(box):
    e = experience(box)
    result = recognise(box, [e], 5.0, SETS)
    assert result.verdict.reward
    assert result.verdict.match == pytest.approx(e.match, abs=1e-9)
    assert result.nearest == "stored"
    assert result.candidates == 1
    assert "stored" in result.verdict.reason


def test_without_experiences_of_its_size_an_object_is_unknown_and_nothing_is_judged(box):
    for experiences in ([], [experience(analyser(boxes(([0.08, 0.04, 0.05], [0, 0, 0]))))]):
        result = recognise(box, experiences, 0.0, SETS)
        assert not result.verdict.reward
        assert result.verdict.match is None
        assert result.candidates == 0
        assert result.nearest is None


@pytest.mark.parametrize(
    ("scale", "candidates"), [(1.0, 1), (1.03, 1), (0.97, 1), (1.05, 1), (0.95, 1), (1.06, 0), (0.94, 0)]
)
def test_candidates_lie_within_the_stated_attribute_distance(box, scale, candidates):
    present = analyser(replace(box.mesh, vertices=box.mesh.vertices * scale))
    found = recognise(present, [experience(box)], 5.0, SETS)
    assert found.candidates == candidates
    assert found.verdict.reward == bool(candidates)


@pytest.mark.parametrize(("power", "name"), [(2, "area"), (3, "volume")])
def test_area_and_volume_are_compared_as_the_scales_that_they_mean(box, power, name):
    a = box.mesh.attributes
    for scale, same in ((1.05, True), (0.95, True), (1.06, False), (0.94, False)):
        other = replace(a, **{name: getattr(a, name) * scale**power})
        assert (attribute_distance(a, other) <= SAME_OBJECT + 1e-9) == same


def test_a_slightly_different_object_is_recognised_with_less_than_the_full_match(box):
    e = experience(box)
    vertices = box.mesh.vertices.copy()
    vertices[vertices[:, 0] > 0] *= [1.0, 0.87, 0.87]
    match = recognise(
        analyser(replace(box.mesh, vertices=vertices)), [e], 5.0, SETS, within=0.2
    ).verdict.match
    assert match is not None
    assert 5.3 < match < 5.7 < e.match  # the paper's own range


def test_a_stored_aim_that_meets_nothing_on_the_present_mesh_counts_zero(box):
    e = experience(box)
    # Two small cubes in opposite corners: the middle, where the thumb aims, is empty.
    half = box.mesh.extents / 2
    corners = boxes(([0.005] * 3, half - 0.0025), ([0.005] * 3, 0.0025 - half))
    assert corners.extents == pytest.approx(box.mesh.extents)
    result = recognise(analyser(corners), [e], 0.1, SETS, distance=lambda a, b: 0.0)
    assert result.candidates == 1
    assert result.verdict.match == 0.0
    assert not result.verdict.reward
    assert result.nearest is None
    assert recognise(analyser(corners), [e], 0.0, SETS, distance=lambda a, b: 0.0).verdict.reward


def test_the_analyser_runs_on_the_present_mesh_at_the_stored_plane_flip_value_and_fingers(box):
    class Recorder:
        mesh = box.mesh

        def __init__(self):
            self.aims = []

        def explore(self, q, aim):
            self.aims.append(aim)
            return box.explore(q, aim)

    e = experience(box, Aim(planes=[10], values=[-0.25], fingers=[3], flips=[True]))
    recorder = Recorder()
    recognise(recorder, [e], 5.0, SETS)
    (aim,) = recorder.aims
    assert list(aim.planes) == [10]
    assert list(aim.values) == [-0.25]
    assert list(aim.fingers) == [3]
    assert list(aim.flips) == [True]


def test_the_wrench_decides_where_the_attributes_agree(box):
    e = experience(box)
    foreign = replace(e, wrench=np.where(np.abs(e.wrench) > 0.6, 0.0, 1.3), object_name="foreign")
    alone = recognise(box, [foreign], 5.0, SETS)
    assert alone.candidates == 1
    assert not alone.verdict.reward
    assert alone.verdict.match == pytest.approx(float(tfvadi(foreign.wrench, e.wrench, SETS)), abs=1e-9)


def test_the_best_experience_counts_in_whatever_order_and_of_whatever_kind(box):
    good = experience(box)
    bad = replace(good, wrench=-good.wrench - 1.0, object_name="foreign", kind="task")
    for kind in ("seed", "task", "best", "landmark"):
        known = replace(good, kind=kind)
        for order in ([known, bad], [bad, known], [bad, bad, known, known]):
            result = recognise(box, order, 5.0, SETS)
            assert result.nearest == "stored"
            assert result.verdict.match == pytest.approx(good.match, abs=1e-9)
            assert result.candidates == len(order)


def test_recognition_uses_its_threshold_with_the_same_slack(box):
    e = experience(box)
    assert recognise(box, [e], e.match, SETS).verdict.reward
    assert recognise(box, [e], e.match + 0.9e-9, SETS).verdict.reward
    assert not recognise(box, [e], min(e.match + 1e-6, 6.0), SETS).verdict.reward or e.match >= 6 - 1e-9


def test_the_distance_and_its_limit_can_be_chosen(box):
    e = experience(box)
    seen = []

    def distance(a: Attributes, b: Attributes) -> float:
        seen.append((a.extents.tolist(), b.extents.tolist()))
        return 0.7

    present = analyser(boxes(([0.1, 0.1, 0.1], [0, 0, 0])))
    assert recognise(present, [e], 5.0, SETS, distance=distance, within=0.69).candidates == 0
    assert recognise(present, [e], 5.0, SETS, distance=distance, within=0.7).candidates == 1
    assert seen == 2 * [([0.1, 0.1, 0.1], box.mesh.extents.tolist())]


def test_a_box_and_a_ball_of_equal_extents_are_not_one_another():
    ball = load_library_object("sphere")
    block = boxes((ball.extents, [0, 0, 0]))
    for present, stored in ((ball, block), (block, ball)):
        assert recognise(analyser(present), [experience(analyser(stored))], 5.0, SETS).candidates == 0


def taught(mesh: TriangleMesh) -> list[Experience]:
    """What the memory holds of an object after one lesson."""
    pa = analyser(mesh)
    q = parse_task("lift").q
    return experiences_of(pa, mesh.name, q, explore(pa, q, SETS, enough=3.0), SETS)


@pytest.mark.parametrize(
    ("stored", "present"),
    [
        ("prism", "cylinder"),
        ("cylinder", "prism"),
        ("prism", "jar"),
        ("wedge", "bottle"),
        ("sphere", "apple"),
    ],
)
def test_objects_of_other_shape_stretched_to_equal_extents_are_not_one_another(stored, present):
    """Their net wrenches are almost equal, so that TFVADI alone takes one for the other."""
    first, second = load_library_object(stored), load_library_object(present)
    vertices = (second.vertices - second.cog) * (first.extents / second.extents)
    stretched = TriangleMesh(name=present, vertices=vertices, triangles=second.triangles)
    lessons = taught(first)
    assert recognise(analyser(first), lessons, 5.0, SETS).verdict.reward
    assert not recognise(analyser(stretched), lessons, 5.0, SETS).verdict.reward


@pytest.mark.parametrize("name", ["mug", "hammer", "wedge"])
@pytest.mark.parametrize("scale", [0.95, 0.97, 1.03, 1.05])
def test_an_object_scaled_by_up_to_five_per_cent_is_recognised(name, scale):
    mesh = load_library_object(name)
    scaled = TriangleMesh(name=name, vertices=mesh.vertices * scale, triangles=mesh.triangles)
    result = recognise(analyser(scaled), taught(mesh), 5.0, SETS)
    assert result.verdict.reward
    assert result.nearest == name
