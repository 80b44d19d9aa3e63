"""Meta control's settings, and the report of a run."""

from __future__ import annotations

import json
from importlib.resources import files

import numpy as np
import pytest

from preshape.hiis.critic import Thresholds
from preshape.hiis.decision import Decision, Settings, Status, Transition, decided
from preshape.hiis.fuzzy import FuzzySets
from preshape.tasks import parse_task
from preshape.types import ContactCoefficients
from test_analyser import VIRTUAL

STEPS = [Transition(mode=mode, outcome="penalty", reason=f"reason {mode}") for mode in (0, 1, 2)]


def report(status: Status = Status.ANSWER, **rest) -> Decision:
    return decided(parse_task("lift"), 2, status, STEPS, None, **rest)


def test_settings_are_the_papers_unless_changed() -> None:
    settings = Settings()
    assert settings.seed == 0
    for found, default in (
        (settings.thresholds, Thresholds()),
        (settings.sets, FuzzySets()),
        (settings.coefficients, ContactCoefficients()),
    ):
        assert type(found) is type(default)
        for name in type(default).__dataclass_fields__:
            assert np.array_equal(getattr(found, name), getattr(default, name)), name


def test_each_status_has_a_name_of_the_schema_and_a_sentence_of_its_own() -> None:
    schema = json.loads(files("preshape").joinpath("schema/plan.schema.json").read_text(encoding="utf-8"))
    assert {status.value for status in Status} == set(schema["properties"]["status"]["enum"])
    assert len({status.help for status in Status}) == len(Status)
    assert "no grasp" in Status.NO_GRASP.help.lower()
    assert "known" in Status.CORRECTION.help


def test_a_report_gives_the_last_steps_reason_and_keeps_every_step() -> None:
    decision = report()
    assert decision.reason == "reason 2"
    assert decision.transitions == tuple(STEPS)
    assert (decision.mode, decision.task.label) == (2, "lift:+z")
    assert (decision.grasp, decision.best, decision.alternatives, decision.offers) == (None, None, (), ())


def test_the_best_grasp_is_the_answer_where_there_is_one() -> None:
    assert report(grasp=VIRTUAL).best is VIRTUAL
    missed = report(Status.DEADLOCK, best=VIRTUAL)
    assert missed.grasp is None
    assert missed.best is VIRTUAL


@pytest.mark.parametrize("status", Status)
def test_only_a_deadlock_waits_for_a_reset(status: Status) -> None:
    assert report(status).deadlock == (status is Status.DEADLOCK)
