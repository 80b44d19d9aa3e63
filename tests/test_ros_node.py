"""The ROS 2 node of the examples, with stand-ins for rclpy; what it publishes is decoded by rosbags alone."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import pytest

import arm_models
from preshape.hands.load import load_hand
from test_export import same

NODE = Path(__file__).parent.parent / "examples" / "ros2" / "grasp_node.py"


class Publisher:
    """What rclpy's publisher takes: a message of its type, or one that is serialised."""

    def __init__(self, kind: type, topic: str, qos: Any) -> None:
        self.kind, self.topic, self.qos = kind, topic, qos
        self.sent: list[Any] = []

    def publish(self, message: Any) -> None:
        assert isinstance(message, bytes | self.kind), type(message)
        self.sent.append(message)


class Node:
    """The part of rclpy's Node that the example uses."""

    parameters: ClassVar[dict[str, Any]] = {}

    def __init__(self, name: str) -> None:
        self.name, self.known, self.publishers, self.heard = name, {}, {}, {}
        self.log: list[tuple[str, str]] = []

    def declare_parameter(self, name: str, default: Any) -> None:
        self.known[name] = self.parameters.get(name, default)
        assert type(self.known[name]) is type(default), "rclpy keeps the type of the default"

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value=self.known[name])

    def create_publisher(self, kind: type, topic: str, qos: Any) -> Publisher:
        self.publishers[topic] = Publisher(kind, topic, qos)
        return self.publishers[topic]

    def create_subscription(self, kind: type, topic: str, callback: Any, qos: Any) -> None:
        self.heard[topic] = callback

    def get_logger(self) -> Any:
        return SimpleNamespace(
            info=lambda text: self.log.append(("info", text)),
            error=lambda text: self.log.append(("error", text)),
        )

    def destroy_node(self) -> None:
        self.log.append(("info", "destroyed"))


class String:
    def __init__(self, data: str = "") -> None:
        self.data = data


def modules(requests: list[str], nodes: list[Node]) -> dict[str, ModuleType]:
    """Stand-ins for the modules of ROS 2; ``spin`` delivers the requests."""

    def module(name: str, **content: Any) -> ModuleType:
        made = ModuleType(name)
        made.__dict__.update(content)
        return made

    def spin(node: Node) -> None:
        nodes.append(node)
        for text in requests:
            node.heard["~/request"](String(text))
        raise KeyboardInterrupt

    policy = SimpleNamespace(RELIABLE=1, TRANSIENT_LOCAL=2)
    return {
        "rclpy": module("rclpy", init=lambda: None, spin=spin, try_shutdown=lambda: None),
        "rclpy.node": module("rclpy.node", Node=Node),
        "rclpy.qos": module(
            "rclpy.qos", QoSProfile=SimpleNamespace, ReliabilityPolicy=policy, DurabilityPolicy=policy
        ),
        "moveit_msgs": module("moveit_msgs"),
        "moveit_msgs.msg": module("moveit_msgs.msg", Grasp=type("Grasp", (), {})),
        "std_msgs": module("std_msgs"),
        "std_msgs.msg": module("std_msgs.msg", String=String),
        "trajectory_msgs": module("trajectory_msgs"),
        "trajectory_msgs.msg": module("trajectory_msgs.msg", JointTrajectory=type("JointTrajectory", (), {})),
    }


def ran(monkeypatch: pytest.MonkeyPatch, requests: list[str], **parameters: Any) -> Node:
    """The node after it has answered requests, started as a script."""
    nodes: list[Node] = []
    for name, stand_in in modules(requests, nodes).items():
        monkeypatch.setitem(sys.modules, name, stand_in)
    monkeypatch.setattr(Node, "parameters", {"memory": ":memory:", "hand": "utah_mit", **parameters})
    runpy.run_path(str(NODE), run_name="__main__")
    assert nodes[0].log[-1] == ("info", "destroyed")
    return nodes[0]


def decoded(node: Node, topic: str, kind: str) -> list[Any]:
    """Messages that were published serialised, decoded by rosbags."""
    from preshape.export.ros_bag import typestore

    return [typestore().deserialize_cdr(content, kind) for content in node.publishers[topic].sent]


def test_a_request_becomes_grasps_and_trajectories(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    hand = load_hand("utah_mit")
    node = ran(
        monkeypatch,
        ["cube lift"],
        arm=arm_models.written(tmp_path, arm_models.six_joints()),
        arm_tip="tip",
        mount=" ".join(map(str, arm_models.mount_along(hand))),
        base_pose="-0.45 0 0 1 0 0 0",
    )
    (said,) = node.publishers["~/plan"].sent
    document = json.loads(said.data)
    assert document["status"] == "answer"
    answers = [document, *document["alternatives"]]
    grasps = decoded(node, "~/grasps", "moveit_msgs/msg/Grasp")
    assert len(grasps) == len(answers)
    assert [g.id for g in grasps] == [f"cube/lift:+z/utah_mit/{k}" for k in range(len(answers))]
    for grasp, answer in zip(grasps, answers, strict=True):
        point = grasp.pre_grasp_posture.points[0]
        assert point.positions.tolist() == answer["hand"]["pregrasp"]["q"]
        way = grasp.pre_grasp_approach.direction.vector
        assert [way.x, way.y, way.z] == pytest.approx(answer["way_in"])
    kind = "trajectory_msgs/msg/JointTrajectory"
    (arm,), (fingers,) = decoded(node, "~/arm_trajectory", kind), decoded(node, "~/hand_trajectory", kind)
    assert arm.joint_names == document["arm"]["joints"]
    assert arm.points[0].positions.tolist() == document["arm"]["path"]["q"][0]
    assert arm.points[-1].positions.tolist() == document["arm"]["path"]["q"][-1]
    clocks = [[(p.time_from_start.sec, p.time_from_start.nanosec) for p in t.points] for t in (arm, fingers)]
    assert clocks[0] == clocks[1]
    assert all(publisher.qos.durability == 2 for publisher in node.publishers.values())


def test_the_messages_are_those_of_the_export(monkeypatch: pytest.MonkeyPatch) -> None:
    from preshape.export.moveit import MoveItOptions, moveit_grasps
    from preshape.export.planned import planned_grasps

    node = ran(monkeypatch, ["box lift"], frame="box", count=1)
    (said,) = node.publishers["~/plan"].sent
    grasps, _ = planned_grasps(json.loads(said.data), "plan")
    (message,) = moveit_grasps(grasps, MoveItOptions(frame="box"))
    (read,) = decoded(node, "~/grasps", "moveit_msgs/msg/Grasp")
    assert same(read, message) > 50
    assert not node.publishers["~/arm_trajectory"].sent


def test_json_has_any_keyword_and_a_bad_request_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = {"object": "cube", "task": "lift", "approaches": "-z", "count": 1}
    bad = [
        "cube",
        "",
        "cube fly",
        '{"object": "cube"}',
        '{"object": "cube", "task": "lift", "colour": 1}',
        "{",
    ]
    node = ran(monkeypatch, [json.dumps(asked), *bad])
    documents = [json.loads(said.data) for said in node.publishers["~/plan"].sent]
    assert documents[0]["request"]["approaches"] == "-z"
    assert [d["status"] for d in documents[1:]] == ["error"] * len(bad)
    assert "OBJECT TASK" in documents[1]["reason"]
    assert "fly" in documents[3]["reason"]
    assert "colour" in documents[5]["reason"]
    assert len(node.publishers["~/grasps"].sent) == 1
    assert [kind for kind, _ in node.log].count("error") == len(bad)
