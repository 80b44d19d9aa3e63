"""Two opposed fingers are a pivot: the margin of a turn about their line is what physics holds, no more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from preshape.closure.settings import ClosureSettings
from preshape.kernels.margin.host import margins
from preshape.physics.hold.six_directions import hold_test
from preshape.physics.protocol import HoldProtocol
from preshape.physics.scene import build_scene
from test_physics_scene import BOX, CLAMP, FAST, HAND, SIDE, clamp, grasp_of

PRESS = 2 * 2000.0 * 0.005
"""Sum of the normal forces [N]: two servos of 2000 N/m, 5 mm beyond the surface."""
TURN = np.array([[0.0, 0, 0, 1, 0, 0], [0.0, 0, 0, -1, 0, 0]])


def promised(torsion: float, friction: float = FAST.friction) -> float:
    """Torque about the line through two opposed contacts that the margin promises [N m]."""
    points, normals = np.zeros((1, 8, 3)), np.zeros((1, 8, 3))
    points[0, :2, 0], normals[0, :2, 0] = [-SIDE[0], SIDE[0]], [1.0, -1.0]
    found = margins(
        points, normals, [2], wrenches=TURN, friction=friction, torsion=torsion, length=float(SIDE[0])
    )
    return float(found.strength[0]) * float(SIDE[0]) * PRESS


def held(radius: float, torque: float) -> bool:
    """Whether two round fingertips of this radius [m] hold the box against a torque about their line."""
    text = CLAMP
    for side, sign in (("left", -1), ("right", 1)):
        flat = f'<geom name="{side}" type="box" size="0.005 0.04 0.04" mass="0.05"/>'
        place = sign * (radius - 0.005)
        assert flat in text
        text = text.replace(
            flat, f'<geom name="{side}" type="sphere" size="{radius}" pos="{place} 0 0" mass="0.05"/>'
        )
    # A force probe of 1 N; torque probes of the wanted torque.
    rules = replace(FAST, probes="all", lever=torque / (FAST.mass * FAST.acceleration), stop_early=False)
    scene = build_scene(replace(HAND, mjcf=text), BOX, 1.0, rules)
    result = hold_test(scene, grasp_of(clamp(0.0), clamp(0.0052), clamp(0.01)), rules)
    about = [probe for probe in result.probes if probe.name in ("torque +x", "torque -x")]
    assert len(about) == 2
    return all(probe.held for probe in about)


@pytest.mark.parametrize("radius", [0.004, 0.02])
def test_two_opposed_fingers_hold_a_turn_about_their_line_by_torsion_alone(radius: float) -> None:
    most = promised(HoldProtocol().torsion)
    assert most == pytest.approx(0.02 * PRESS, rel=0.01)
    assert held(radius, 0.7 * most)
    assert not held(radius, 1.4 * most)


@pytest.mark.parametrize("radius", [0.004, 0.02])
def test_what_planning_counts_on_is_held(radius: float) -> None:
    settings = ClosureSettings()
    planned = promised(settings.gamma, settings.friction * settings.friction_share)
    assert 0 < planned < 0.25 * promised(HoldProtocol().torsion)
    assert held(radius, planned)
