"""Every scan of the reference data gets an answer or a reasoned refusal."""

from __future__ import annotations

import pytest

import preshape
from preshape.exceptions import ObjectError

SCANS = (
    "a_lego_duplo apple banana baseball bowl cracker_box foam_brick hammer large_clamp large_marker lemon "
    "master_chef_can mug mustard_bottle padlock phillips_screwdriver pitcher_base power_drill pudding_box "
    "scissors spatula tennis_ball tuna_fish_can wood_block"
).split()


@pytest.fixture(scope="module")
def memory():
    with preshape.Memory.open(":memory:") as store:
        yield store


@pytest.mark.parametrize("name", SCANS)
def test_scan_gets_an_answer_or_a_reason(reference, memory, name):
    path = reference / "ycb" / f"{name}.obj"
    scale = 1.0
    mesh = preshape.load_object(path)
    if mesh.extents.max() > 4 * 0.043:
        with pytest.raises(ObjectError, match="4U") as refusal:
            preshape.plan(path, "lift", memory=memory, hand="utah_mit")
        assert "--scale" not in str(refusal.value)  # another size is another object
        assert "--analyser closure" in str(refusal.value)
        scale = 4 * 0.043 / mesh.extents.max()
    plan = preshape.plan(path, "lift", memory=memory, scale=scale, hand="utah_mit")
    decision = plan.decision
    assert decision.reason
    if decision.grasp is None:
        assert decision.status.value in ("task_correction", "deadlock", "no_grasp")
        assert decision.offers or decision.status.value != "task_correction"
    else:
        assert decision.grasp.tfvadi >= 3.0 - 1e-9
        assert plan.hand_result.reason


def test_the_list_is_the_folder(reference):
    assert sorted(path.stem for path in (reference / "ycb").glob("*.obj")) == sorted(SCANS)
