"""What messages and answers say: enough digits, enough to tell answers apart, and what to do next."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import preshape
from preshape.cli.printing import print_rows
from preshape.exceptions import InputError, UnknownTask
from preshape.hiis.critic import judge
from preshape.memory import Memory
from preshape.planning.document import lacking
from preshape.tasks import OTHER_NAMES, family_names, parse_task
from preshape.types import told_apart, two_digits
from preshape.viewer import words

numbers = st.floats(0.0, 6.0)


@settings(derandomize=True, deadline=None)
@given(a=numbers, b=numbers)
def test_different_numbers_read_differently(a: float, b: float) -> None:
    first, second = told_apart(a, b)
    assert (first == second) == (a == b)
    if first != second:
        assert (float(first) < float(second)) == (a < b)
    if f"{a:.2f}" != f"{b:.2f}":
        assert (first, second) == (f"{a:.2f}", f"{b:.2f}")  # and not with more digits than needed


def test_a_score_just_below_its_threshold_reads_below_it() -> None:
    assert judge(2.9996, 3.0).reason == "TFVADI 2.9996 is below the threshold 3.0000"
    assert judge(2.5, 3.0).reason == "TFVADI 2.50 is below the threshold 3.00"
    assert judge(3.0, 3.0).reason == "TFVADI 3.00 meets the threshold 3.00"


def test_a_quality_that_is_not_enough_never_reads_as_enough() -> None:
    grip = {"quality": 2.998, "task_margin": 0.04, "hold_margin": 0.999, "forces": []}
    shown = {name: number for name, number, _ in words.figures({"grip": grip, "contacts": []})}
    assert shown == {"quality": "2.998", "task margin": "0.04", "hold margin": "0.999", "press": "0"}


@settings(derandomize=True, deadline=None)
@given(margin=st.floats(1e-6, 1e3))
def test_a_margin_is_never_shown_as_nothing(margin: float) -> None:
    shown = float(two_digits(margin))
    assert shown == pytest.approx(margin, rel=0.06)
    assert two_digits(0.0) == "0"


@pytest.mark.parametrize(
    ("asked", "task"),
    [
        ("pick it up", "lift"),
        ("grasp", "lift"),
        ("hold", "lift"),
        ("place the mug", "insert"),
        ("hammer", "strike"),
        ("Rotate", "turn"),
        ("please pour", "pour"),
        ("lit", "lift"),
        ("hand over", "hand_over"),
    ],
)
def test_common_words_lead_to_a_task(asked: str, task: str) -> None:
    assert task in UnknownTask(asked, family_names()).nearest()
    meant = OTHER_NAMES.get(asked.lower().replace(" ", "_"))
    if meant is not None:
        assert parse_task(asked).name == meant
    elif asked != "hand over":
        with pytest.raises(UnknownTask, match=f"did you mean .*{task}.*Known: lift, push"):
            parse_task(asked)


def test_every_word_leads_to_a_task_that_exists() -> None:
    assert set(UnknownTask._MEANT) <= set(family_names())
    assert UnknownTask("xyzzy", family_names()).nearest() == ()


@pytest.mark.parametrize("more", [{"mass": 0.3}, {"table": "auto"}, {"friction": 0.3}])
def test_what_rays_ignore_leads_to_a_real_hand(more: dict) -> None:
    with pytest.raises(
        InputError, match=r"a real hand \(--hand shadow, .*the analyser of utah_mit here is rays"
    ):
        preshape.plan("mug", "lift", hand="utah_mit", memory=":memory:", **more)


def test_answers_of_one_plan_are_told_apart() -> None:
    plan = preshape.plan("mug", "pour", memory=":memory:", learn=False, count=4, hand="utah_mit")
    document = preshape.plan_to_json(plan)
    lines = [words.place_words(answer) for answer in words.answers_of(document)]
    assert len(lines) > 2
    assert len(set(lines)) == len(lines)
    said = " ".join(str(plan).replace("│", " ").split())
    assert all(line in said for line in lines[1:])
    names = words.answer_names(words.answers_of(document))
    assert len(set(names)) == len(names)
    assert all(name in said for name in names[1:])
    assert {answer["part"] for answer in words.answers_of(document)} <= {"handle", "body", "rim", "inside"}


def grip_at(points: list[list[float]], **changes) -> dict:
    fingers = ["thumb", "index", "middle"]
    made = {
        "grip": {"type": {"name": "tripod", "power": "precision", "opposition": "pad"}},
        "contacts": [{"finger": f, "point": p} for f, p in zip(fingers, points, strict=True)],
        "way_in": [0.0, 0.2, -0.98], "scene": {"up": [0, 0, 1]}, "part": "handle",
        "opposition_axis": [0, 1, 0], "flip": False,
    }  # fmt: skip
    return made | changes


def test_answers_are_named_by_what_differs_and_earlier_names_stay() -> None:
    points = [[0.0, 0.02, 0.1], [0.01, -0.02, 0.1], [-0.01, -0.02, 0.1]]
    higher = [[x, y, z + 0.03] for x, y, z in points]
    other = {"power": "power", "opposition": "palm", "name": "medium wrap"}
    answers = [
        grip_at(points),
        grip_at(points, part=None, way_in=[-1.0, 0.0, 0.0]),
        grip_at(points, grip={"type": other}, way_in=[0.0, 0.0, 1.0]),
        grip_at(higher, flip=True),
        grip_at(higher, flip=True),
        grip_at(higher, flip=True),
        grip_at(higher, flip=True),
        grip_at([[x, 2 * y, z] for x, y, z in points]),
        grip_at(points, scene={"up": [0, 0, -1]}),
    ]
    names = words.answer_names(answers)
    assert names == [
        "tripod from above on handle, 40 mm",
        "tripod from +X, 40 mm",
        "medium wrap from below on handle, 40 mm",
        "tripod from above on handle, 40 mm, thumb at -Y",
        "tripod from above on handle, 40 mm, at Z +130 mm",
        "tripod from above on handle, 40 mm, thumb at -Y, at Z +130 mm",
        "tripod from above on handle, 40 mm, no. 2",
        "tripod from above on handle, 80 mm",
        "tripod from below on handle, 40 mm",
    ]
    for count in range(len(answers)):
        assert words.answer_names(answers[:count]) == names[:count]


def test_a_grip_is_told_from_another_by_its_palm() -> None:
    one = {"opposition_axis": [0, 1, 0], "approach_axis": [0, 0, -1], "way_in": [0, 0, -1], "flip": False}
    one |= {"grip": {"quality": 3.0}, "hand": {"grasp": {"palm_pose": [0.01, 0, 0.1, 1, 0, 0, 0]}}}
    assert words.place_words(one).endswith("thumb on the +Y side, comes in along -Z, palm at 10, 0, 100 mm")


def test_the_repr_of_a_deadlock_says_what_was_best_and_why_it_is_not_enough() -> None:
    strict = preshape.Settings(thresholds=preshape.Thresholds(estimation=5.99))
    plan = preshape.plan("dolphin", "pour", memory=":memory:", settings=strict, hand="utah_mit")
    shown = repr(plan)
    assert "\n" not in shown
    assert f"deadlock, the best is {plan.best.grasp.plane.label}, TFVADI" in shown
    assert "is below the threshold 5.99" in shown


def test_what_is_lacking_is_the_judged_grasp_not_the_recognition() -> None:
    steps = [
        {"mode": 0, "outcome": "penalty", "reason": "quality 1.00 is below the threshold 3.00"},
        {"mode": 1, "outcome": "penalty", "reason": "quality 2.90 is below the threshold 3.00"},
        {"mode": 2, "outcome": "known", "reason": "its shape is that of mug"},
    ]
    document = {"reason": steps[-1]["reason"], "transitions": steps}
    assert lacking(document) == "quality 2.90 is below the threshold 3.00; its shape is that of mug"
    assert lacking({**document, "reason": steps[1]["reason"]}) == steps[1]["reason"]


def test_reading_a_memory_leaves_no_files_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "memory.sqlite"
    with Memory.open(path) as store:
        assert not store.read_only
    before = path.read_bytes()
    with Memory.open(path, read_only=True) as store:
        assert store.count() == 0
    assert os.listdir(tmp_path) == ["memory.sqlite"]
    assert path.read_bytes() == before
    # While another process writes, its log stays.
    with Memory.open(path) as writing:
        Memory.open(path, read_only=True).close()
        assert writing.count() == 0


def test_a_list_loses_no_hand_in_a_narrow_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # As `memory show` prints it; the other columns take nearly the whole line.
    hands = ["utah_mit", "shadow/closure", "dual_arm_gripper_of_ours"]
    monkeypatch.setenv("COLUMNS", "40")
    print_rows(("object", "last seen (UTC)", "~hand"), [("mug", "2026-11-30 12:00", " ".join(hands))])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 40
    assert "".join(hands) in "".join(line[26:].strip() for line in lines[1:])
    assert "…" not in "".join(lines)
