"""``preshape bench learning``: what is met is learnt, and what experience is worth is counted."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from preshape.cli.main import run
from preshape.closure.settings import ClosureSettings
from preshape.studies.closure_learning import (
    SAME,
    LearningStudy,
    PairResult,
    _same_margin_quality,
    study,
    table,
)

pytestmark = pytest.mark.usefixtures("session_cache")
QUICK = ClosureSettings(everywhere=400, elite=8, rounds=1, finished=2, persistence=0, threads=1)


@pytest.fixture(scope="module")
def found() -> LearningStudy:
    told: list[tuple[int, int]] = []
    made = study(
        length=2, held_out=1, seed=3, closure=QUICK, progress=lambda done, of: told.append((done, of))
    )
    assert {of for _, of in told} == {7}  # the bar's end stays where it is, and is reached
    assert [done for done, _ in told] == sorted({done for done, _ in told})
    assert told[-1] == (7, 7)
    return made


def test_objects_held_out_were_never_met(found: LearningStudy) -> None:
    met = {one.name.partition("@")[0] for one in found.stream}
    held_out = {one.name.partition("@")[0] for one in found.held_out}
    assert len(met) == 2
    assert held_out
    assert not met & held_out
    assert "cube" not in met | held_out  # every memory is taught it first


def test_the_same_pairs_are_asked_for_three_times(found: LearningStudy) -> None:
    asked = [
        [(one.name, one.task) for one in part] for part in (found.fresh, found.held_out, found.same_margin)
    ]
    assert asked[0] == asked[1] == asked[2]
    assert all(one.mode == 3 for one in found.fresh)
    # Whoever explores everything closes all candidates of mode 3 at least.
    assert all(one.tried >= QUICK.everywhere for one in found.fresh)


def test_what_was_answered_is_asked_for_again(found: LearningStudy) -> None:
    answered = [one for one in found.stream if one.answered]
    assert [(one.name, one.task) for one in found.repeated] == [(one.name, one.task) for one in answered]
    assert all(one.answered and one.mode == 0 for one in found.repeated)
    assert all(b.quality >= 0.95 * a.quality for a, b in zip(answered, found.repeated, strict=True))


def test_the_same_seed_shows_the_same(found: LearningStudy) -> None:
    again = study(length=2, held_out=1, seed=3, closure=replace(QUICK, threads=2))
    for part in ("stream", "repeated", "fresh", "held_out", "same_margin"):
        rows = [
            [(m.name, m.task, m.mode, m.quality, m.tried) for m in getattr(s, part)] for s in (found, again)
        ]
        assert rows[0] == rows[1]


def met(tried: int, *, answered: bool = True, mode: int = 0) -> PairResult:
    return PairResult(name="a@1", task="t", mode=mode, answered=answered, quality=4.0, tried=tried)


def test_candidates_are_counted_to_the_end() -> None:
    """What experience does not reach costs what it tried and the exploring after it; nothing else counts."""
    fresh = (met(1000, mode=3), met(2000, mode=3), met(4000, mode=3, answered=False))
    same_margin = (met(50), met(300, answered=False, mode=2), met(10))
    explored = (met(50), met(2300, answered=False, mode=3), met(10))
    made = LearningStudy(stream=(met(9),), repeated=(), fresh=fresh, held_out=fresh, same_margin=same_margin)
    np.testing.assert_allclose(made.ratios(), [0.05, 1.15])
    np.testing.assert_allclose(replace(made, same_margin=explored).ratios(), [0.05, 1.15])
    figures = made.figures()
    assert figures["same_margin_ratio_median"] == pytest.approx(0.6)
    assert figures["same_margin_within_a_tenth"] == 1
    assert (figures["fresh_answered"], figures["held_out"]) == (2, 3)
    rows = dict(table(made).rows)
    assert rows["ratio of a tenth or less"] == "1 of 2"


@pytest.mark.parametrize("margin", [0.2, 1.0, 3.7])
def test_the_same_margin_is_a_share_of_the_margin_not_of_the_quality(margin: float) -> None:
    quality = 6 * (1 - 2**-margin)
    assert _same_margin_quality(quality) == pytest.approx(6 * (1 - 2 ** -(SAME * margin)))
    assert _same_margin_quality(6.0) < 6.0


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert run(["bench", "learning", "--length", "1", "--held-out", "1", "--json", "--out", str(out)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["status"] == "answer"
    assert told["met"] == told["held_out"] == 1
    report = json.loads((out / "report.json").read_text())
    assert report["figures"] == {k: v for k, v in told.items() if k not in ("status", "files")}
    assert [len(report[part]) for part in ("stream", "fresh", "held_out", "same_margin")] == [1, 1, 1, 1]
    with Image.open(out / "learning.png") as image:
        assert len(np.unique(np.asarray(image.convert("RGB")).reshape(-1, 3), axis=0)) > 50
    assert told["files"] == [str(out / "report.json"), str(out / "learning.png")]


@pytest.mark.parametrize("words", ["--length 0", "--held-out 0", "--seed -1", "--out ''"])
def test_bad_numbers_are_refused(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["bench", "learning", *words.replace("''", "").split(" ")]) == 2
    assert words.split()[0] in capsys.readouterr().err
