"""Motors: laws of joints that follow them, in descriptions, postures, kernels, squeezes and physics."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import preshape
from coupled_hands import BENT, CUBIC, EXAMPLE, GEAR, TENDON, coupled_hand
from preshape.closure.candidates import Region, draw_candidates
from preshape.closure.hand_tables import hand_tables
from preshape.closure.preshapes import posture_at, preshapes
from preshape.closure.settings import ClosureSettings
from preshape.exceptions import HandError
from preshape.hands.compiled import read_model
from preshape.hands.hand import Hand
from preshape.hands.load import load_hand, read_description
from preshape.hands.mirror import mirrored
from preshape.hands.motors import ADAPTIVE, RIGID, adaptive_motor, direct_motor, rigid_motor
from preshape.hands.rewrite import rebuilt
from preshape.kernels.closing.host import ClosingKernel, Fate
from preshape.kernels.closing.plain import close_plain
from preshape.kernels.field.host import prepare_field
from preshape.objects.library import load_library_object
from preshape.physics.hand import published_hand
from preshape.planning.document import plan_to_json

QUICK = ClosureSettings(everywhere=1000, wraps=300, elite=16, rounds=1, finished=4)
LAWFUL = 1e-6
"""Largest deviation from a law [rad]."""

LIMITS = {"a": np.array([-0.5, 1.5]), "b": np.array([0.0, 1.0]), "c": np.array([-2.0, 2.0])}


def broken(hand: Hand, q: np.ndarray) -> float:
    """By how much postures (n, j) break laws, inequalities or limits [rad]."""
    columns = {joint: k for k, joint in enumerate(hand.joints)}
    worst = [np.abs(hand.follow(hand.controls(q)) - q).max()]
    for motor in hand.motors:
        worst += [(q[:, columns[low]] - q[:, columns[high]]).max() for low, high in motor.order]
    return float(max(worst))


# -- laws -------------------------------------------------------------------------------------------


def test_a_rigid_motor_stops_where_a_follower_does() -> None:
    motor = rigid_motor("a", {"b": np.array([0.2, 0.4]), "c": np.array([0.0, -2.0])}, LIMITS)
    assert motor.joints == ("a", "b", "c")
    assert motor.range == pytest.approx([-0.5, 1.0], abs=1e-9)  # c ends at 2.0
    q = motor.angles(np.linspace(*motor.range.tolist(), 7))
    assert q[:, 1] == pytest.approx(0.2 + 0.4 * q[:, 0])
    for m in (-0.3, 0.8):
        step = (motor.angles(m + 1e-6) - motor.angles(m - 1e-6)) / 2e-6
        assert motor.rates(m) == pytest.approx(step, abs=1e-8)


def test_a_polynomial_keeps_to_the_longest_run_of_possible_commands() -> None:
    wavy = rigid_motor("a", {"b": np.array([0.0, 0.0, 4.0])}, LIMITS)  # b = 4 a², at most 1
    assert wavy.range == pytest.approx([-0.5, 0.5], abs=1e-8)
    with pytest.raises(HandError, match="at no angle of it are all its joints within their limits; b"):
        rigid_motor("a", {"b": np.array([5.0])}, LIMITS)
    with pytest.raises(HandError, match="up to 5 coefficients"):
        rigid_motor("a", {"b": np.arange(6.0)}, LIMITS)


def test_an_adaptive_motor_takes_its_unloaded_path() -> None:
    path = np.array([[0.0, 0.0], [1.0, 0.2], [1.4, 1.0]])
    motor = adaptive_motor("t", {"a": 1.0, "b": 2.0}, LIMITS, free=path, order=(("b", "a"),), locks="a")
    assert motor.range == pytest.approx([0.0, 3.4])
    assert motor.angles([0.0, 3.4]) == pytest.approx(path[[0, -1]])
    m = np.linspace(0.0, 3.4, 33)
    assert motor.angles(m) @ motor.weights == pytest.approx(m, abs=1e-12)
    assert (motor.weights @ motor.rates(0.7), motor.weights @ motor.rates(3.0)) == pytest.approx((1.0, 1.0))
    straight = adaptive_motor("t", {"a": 1.0, "b": 1.0}, LIMITS)  # from end to end of both ranges
    assert straight.affine
    assert straight.angles(straight.range) == pytest.approx(np.array([[-0.5, 0.0], [1.5, 1.0]]))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"weights": {"a": 0.0, "b": 1.0}}, "every coefficient of its sum"),
        ({"free": [[0.0, 0.0]]}, "two points or more"),
        ({"free": [[0.0, 0.5], [0.5, 0.0]]}, "the sum must grow"),
        ({"free": [[0.0, 0.0], [1.0, 1.2]]}, "leaves the limits of b"),
        ({"free": [[0.0, 0.1], [1.0, 0.5]], "order": (("b", "a"),)}, "b goes above a"),
    ],
)
def test_an_impossible_adaptive_law_is_refused(change: dict, said: str) -> None:
    given = {"weights": {"a": 1.0, "b": 1.0}, **change}
    with pytest.raises(HandError, match=said):
        adaptive_motor("t", given.pop("weights"), LIMITS, **given)


@pytest.mark.parametrize(
    ("couples", "said"),
    [
        ([{"law": "rigid", "motor": "ring_knuckle"}], "a rigid couple lacks 'follow'"),
        ([{"law": "adaptive", "sum": {"ring_knuckle": 1.0}}], "an? adaptive couple lacks 'motor'"),
        ([{**TENDON, "sum": {"index_knuckle": "a", "index_middle": 1.0}}], "its numbers cannot be read"),
        ([{**GEAR, "follow": {"ring_middle": "0.8"}}], "each coefficient of a law must be a finite number"),
        ([{**GEAR, "follow": {"ring_middle": ["0", "0.8"]}}], "its numbers cannot be read"),
        ([{**TENDON, "sum": {"index_knuckle": "1", "index_middle": 1.0}}], "its numbers cannot be read"),
        ([{**TENDON, "order": [["index_middle"]]}], "its numbers cannot be read"),
        ([{**GEAR, "follow": {"ring_middle": [[1, 2]]}}], "its numbers cannot be read"),
        ([{**GEAR, "law": "loose"}], "rigid or adaptive, got 'loose'"),
        ([{**GEAR, "sum": {}}], "a rigid couple has no key 'sum'"),
        ([GEAR, GEAR], "ring_knuckle is in two couples"),
        ([{**GEAR, "follow": {"elbow": 1.0}}], "names elbow, which is no joint of the hand"),
        (
            [{**GEAR, "follow": {"index_knuckle": 1.0}}],
            "closes the (index|ring) and also moves another finger",
        ),
        ([{**TENDON, "locks": "ring_middle"}], "ring_middle is none of its joints"),
        ([{**TENDON, "motor": "thumb_knuckle"}], "two motors are called thumb_knuckle"),
        ([{**BENT, "free": [[0.0], [1.0]]}], "free"),
        ([{**CUBIC, "follow": "thumb_middle"}], "name the joints and their numbers"),
        ("all", r"\[\[couple\]\] tables"),
    ],
)
def test_a_wrong_couple_is_refused_by_name(couples: object, said: str) -> None:
    data = {**read_description(EXAMPLE), "couple": couples}
    with pytest.raises(HandError, match=said):
        rebuilt(data, read_model(EXAMPLE.with_suffix(".urdf")), "hand.toml")


MJCF = """<mujoco><compiler angle="radian"/><worldbody><body name="palm"><geom size=".02"/>
<body><joint name="a" axis="1 0 0" range="-1 1" ref="0.1"/><geom size=".01"/>
<body><joint name="b" axis="1 0 0" range="-2 2"/><geom size=".01"/>
<body><joint name="c" axis="1 0 0" range="-2 2"/><geom size=".01"/></body></body></body>
</body></worldbody><equality>{equalities}</equality><tendon><fixed name="t"><joint joint="b" coef="1"/>
<joint joint="c" coef="-2"/></fixed></tendon>
<actuator><position name="pull" tendon="t"/></actuator></mujoco>"""


def test_laws_of_a_model_are_read_and_chained() -> None:
    chained = (
        '<joint joint1="b" joint2="a" polycoef="0.2 2 0 0 0"/>'
        '<joint joint1="c" joint2="b" polycoef="0 1 1 0 0"/>'
    )
    (couple,) = read_model(MJCF.format(equalities=chained)).couples
    assert (couple["law"], couple["motor"]) == (RIGID, "a")
    # b = 0.2 + 2 (a - 0.1) and c = b + b²
    assert couple["follow"]["b"] == pytest.approx([0.0, 2.0])
    assert couple["follow"]["c"] == pytest.approx([0.0, 2.0, 4.0])
    (tendon,) = read_model(MJCF.format(equalities="")).couples
    assert tendon == {"law": ADAPTIVE, "motor": "pull", "sum": {"b": 1.0, "c": -2.0}}


@pytest.mark.parametrize(
    ("equalities", "said"),
    [
        ('<joint joint1="b" joint2="a"/><joint joint1="a" joint2="b"/>', "follow each other in a circle"),
        ('<joint joint1="b" joint2="a"/><joint joint1="b" joint2="c"/>', "'b' follows two laws"),
        ('<joint joint1="b"/>', "holds the joint 'b' at one angle: name it under fixed"),
        (
            '<joint joint1="b" joint2="a" polycoef="0 0 0 1 0"/>'
            '<joint joint1="c" joint2="b" polycoef="0 0 1 0 0"/>',
            "by a polynomial of degree 6; at most 4",
        ),
    ],
)
def test_a_law_that_cannot_be_expressed_is_refused_with_the_joint(equalities: str, said: str) -> None:
    with pytest.raises(HandError, match=said):
        _ = read_model(MJCF.format(equalities=equalities)).couples


# -- the hand ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["shadow", "shadow:left", "bent", "tendon"])
def test_every_posture_of_a_hand_is_on_its_laws(kind: str) -> None:
    hand, rng = coupled_hand(kind), np.random.default_rng(3)
    assert hand.coupled
    path = np.stack([hand.at(rng.uniform(0, 1, len(hand.fingers))) for _ in range(40)])
    pool, tables = preshapes(hand, 64), hand_tables(hand)
    closed = posture_at(tables, pool.start, rng.uniform(0.0, 1.0, (len(pool.start), len(hand.fingers))))
    wild = hand.lawful(rng.uniform(hand.limits[:, 0], hand.limits[:, 1], (200, len(hand.joints))))
    for q in (path, pool.start, closed, wild):
        assert broken(hand, q) < LAWFUL
        assert (q > hand.limits[:, 0] - LAWFUL).all()
        assert (q < hand.limits[:, 1] + LAWFUL).all()
    assert (np.ptp(hand.controls(closed), axis=0) > 0.05).mean() > 0.75  # some are not for closing


@pytest.mark.parametrize("kind", ["bent", "tendon", "shadow"])
def test_rates_are_the_derivatives_of_the_postures(kind: str) -> None:
    hand = coupled_hand(kind)
    q, h = hand.at(0.37), 1e-6
    m, numeric = hand.controls(q), np.zeros((len(hand.joints), len(hand.motors)))
    for k in range(len(m)):
        step = h * (np.arange(len(m)) == k)
        numeric[:, k] = (hand.follow(m + step) - hand.follow(m - step)) / (2 * h)
    assert hand.rates(q) == pytest.approx(numeric, abs=1e-7)


def test_the_mirror_image_of_a_coupled_hand_has_the_same_laws() -> None:
    hand = coupled_hand("tendon")
    other = mirrored(hand)
    assert [motor.law for motor in other.motors] == [motor.law for motor in hand.motors]
    q = np.random.default_rng(1).uniform(0, 1, len(hand.fingers))
    assert np.array_equal(other.at(q), hand.at(q))


def test_a_follower_without_limits_gets_those_of_its_law() -> None:
    urdf = EXAMPLE.with_suffix(".urdf").read_text(encoding="utf-8")
    at = urdf.index('<joint name="thumb_middle"')
    bare = urdf[:at] + urdf[at:].replace('<limit lower="0" upper="1.5" effort="1.5" velocity="3"/>', "", 1)
    bare = bare.replace(
        '<joint name="thumb_middle" type="revolute">', '<joint name="thumb_middle" type="continuous">'
    )
    model = read_model(EXAMPLE.with_suffix(".urdf"))
    free = replace(model, ranges={**model.ranges, "thumb_middle": (0.0, 0.0)})
    hand = rebuilt({**read_description(EXAMPLE), "name": "bare", "couple": [CUBIC]}, free, "bare")
    q = hand.motors[1].angles(hand.motors[1].range)
    assert hand.limits[2] == pytest.approx([q[:, 1].min(), q[:, 1].max()], abs=1e-9)


@pytest.mark.parametrize("kind", ["bent", "tendon"])
def test_the_closing_kernel_and_its_plain_version_follow_the_laws_alike(kind: str) -> None:
    hand, mesh = coupled_hand(kind), load_library_object("cube")
    tables, field = hand_tables(hand), prepare_field(mesh, cells=32, cache=None)
    rng = np.random.default_rng(2)
    given = draw_candidates(
        rng, preshapes(hand, 64), mesh.bounds.mean(axis=0), mesh.extents / 2, 300, Region()
    ).candidates
    fast, plain = ClosingKernel(tables, field).close(given), close_plain(tables, field, given)
    same = (fast.fate == plain.fate) & (fast.fate == Fate.CLOSED)
    assert (fast.fate == plain.fate).mean() > 0.98
    assert same.sum() > 15
    away = np.abs(fast.closing - plain.closing)[same]
    assert np.median(away) < 1e-5
    assert (away < 1e-3).mean() > 0.98


# -- physics ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["shadow", "allegro", "leap", "tendon", "locking"])
def test_motors_alone_bring_the_hand_to_every_posture(kind: str) -> None:
    hand = coupled_hand(kind)
    model = mujoco.MjModel.from_xml_string(hand.mjcf)
    assert model.nu == len(hand.motors)
    model.opt.timestep, model.opt.integrator = 0.004, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.gravity[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for _ in range(2):
        wanted = hand.at(rng.uniform(0.2, 1.0, len(hand.fingers)))
        data.qpos[:] = hand.at(0.0)
        begin, end = hand.controls(data.qpos), hand.controls(wanted)
        for share in np.minimum(1.0, np.arange(500) / 250):
            data.ctrl[:] = begin + share * (end - begin)
            mujoco.mj_step(model, data)
        assert np.abs(data.qpos - wanted).max() < 0.01


@pytest.mark.parametrize("model", ["ours", "published"])
def test_a_pressed_finger_of_the_shadow_never_bends_its_last_joint_most(model: str, reference) -> None:
    hand = load_hand("shadow")
    if model == "ours":
        physics = mujoco.MjModel.from_xml_string(hand.mjcf)
    else:
        path = reference / "hands" / "shadow_hand" / "right_hand.xml"
        physics = published_hand(hand, path).spec().compile()
    physics.opt.timestep, physics.opt.integrator = 0.004, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(physics)
    low, high = (physics.joint(f"rh_FFJ{k}") for k in (1, 2))
    for q, joint in ((0.6, low), (0.6, high)):
        data.qpos[int(joint.qposadr[0])] = q
    for k in range(physics.nu):
        name = physics.actuator(k).name
        data.ctrl[k] = 1.2 if name.endswith("FFJ0") else 0.0
    # The object pushes the tip back: a torque that opens the middle joint, more than the tendon makes.
    data.qfrc_applied[int(high.dofadr[0])] = -0.4
    for _ in range(250):
        mujoco.mj_step(physics, data)
    bent = [float(data.qpos[int(joint.qposadr[0])]) for joint in (low, high)]
    assert bent[0] <= bent[1] + 0.01
    assert bent[1] > 0.05


def settled(model: mujoco.MjModel, command: float, pushed: dict[str, float]) -> dict[str, float]:
    """Angles of the index finger's knuckle and middle joint after a second at a command of their motor.

    Args:
        model: The hand ``locking``.
        command: The command [rad]; all others are zero.
        pushed: Torques on joints from outside [N m].
    """
    model.opt.timestep, model.opt.integrator = 0.004, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.gravity[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = mujoco.MjData(model)
    for joint, torque in pushed.items():
        data.qfrc_applied[int(model.joint(joint).dofadr[0])] = torque
    for step in range(500):
        data.ctrl[model.actuator("index_tendon").id] = command * min(1.0, step / 250)
        mujoco.mj_step(model, data)
    return {name: float(data.joint(f"index_{name}").qpos[0]) for name in ("knuckle", "middle")}


def test_a_couple_that_locks_is_one_gear_train_until_its_joint_is_blocked() -> None:
    hand = coupled_hand("locking")
    motor = next(one for one in hand.motors if one.name == "index_tendon")
    model = mujoco.MjModel.from_xml_string(hand.mjcf)
    # A fingertip that is pushed back turns the knuckle most. A tendon alone would yield: the finger opens at
    # the knuckle and curls at the middle joint.
    pushed = settled(model, 1.2, {"index_knuckle": -0.8, "index_middle": -0.3})
    assert pushed["middle"] == pytest.approx(0.4 * pushed["knuckle"], abs=0.01)
    free = motor.angles(1.2)
    assert pushed["knuckle"] > free[0] - 0.2
    # The knuckle meets a stop; the middle joint goes on to what is left of the command.
    model = mujoco.MjModel.from_xml_string(hand.mjcf)
    model.jnt_range[model.joint("index_knuckle").id, 1] = 0.4
    blocked = settled(model, motor.range[1], {})
    assert blocked["knuckle"] < 0.5  # stops are soft
    assert blocked["middle"] > 0.4 * blocked["knuckle"] + 0.5
    # It waits until the motor presses the stop in earnest.
    light = settled(model, 0.4 * 1.4 + 0.15, {})
    assert 0.3 < light["knuckle"] < 0.5
    assert sum(light.values()) < 0.4 * 1.4 + 0.1
    assert light["middle"] == pytest.approx(0.4 * light["knuckle"], abs=0.01)


# -- answers ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["shadow", "bent", "tendon", "locking"])
def test_an_answer_moves_and_presses_as_the_motors_can(kind: str) -> None:
    hand = coupled_hand(kind)
    plan = preshape.plan("cube", "lift", hand=hand, count=2, seed=1, mass=0.1, closure=QUICK, table=None)
    document = plan_to_json(plan)
    assert document["status"] == "answer"
    told = document["hand"]["motors"]
    assert [motor["name"] for motor in told] == [motor.name for motor in hand.motors]
    for answer in (document, *document["alternatives"]):
        stages = [answer["hand"][stage] for stage in ("pregrasp", "grasp", "squeeze")]
        q = np.array([stage["q"] for stage in stages])
        assert broken(hand, q) < LAWFUL
        m = np.array([stage["motors"] for stage in stages])
        assert hand.follow(m) == pytest.approx(q, abs=1e-9)
        torque = hand.rates(q[1]).T @ np.array(answer["grip"]["torques"])
        gains = np.array([motor["gain"] for motor in told])
        assert gains * (m[2] - m[1]) == pytest.approx(torque, abs=1e-6)
        assert (np.abs(torque) <= [motor["torque_limit"] + 1e-9 for motor in told]).all()
        for motor in hand.motors:
            for low, high in motor.order:
                # The tendon alone gives both joints its force; the stop adds to the second joint only.
                needed = {joint: answer["grip"]["torques"][hand.joints.index(joint)] for joint in (low, high)}
                force = torque[[one.name for one in hand.motors].index(motor.name)]
                assert needed[high] >= force - 1e-6
                assert needed[low] <= force + 1e-6


def test_a_direct_hand_has_a_motor_for_every_joint() -> None:
    hand = load_hand("leap")
    assert not hand.coupled
    assert np.array_equal(hand.command_matrix(), np.eye(16))
    assert np.array_equal(hand.rates(hand.at(0.3)), np.eye(16))
    one = direct_motor("if_mcp", hand.limits[0])
    assert np.array_equal(one.angles([0.1, 0.2])[:, 0], [0.1, 0.2])
