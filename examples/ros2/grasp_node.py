"""A ROS 2 node that plans grasps on request: text in, moveit_msgs/Grasp and JointTrajectory out.

    pip install "preshape[ros]"          # beside ROS 2, in the Python that ROS 2 uses
    python3 grasp_node.py --ros-args -p hand:=leap -p table:=auto
    ros2 topic pub --once /preshape/request std_msgs/msg/String "{data: mug lift}"

Topics, all private to the node (``/preshape/…``) until you remap them:

    request          std_msgs/String   "OBJECT TASK", or a JSON object as ``preshape serve`` takes it
    plan             std_msgs/String   plan.json, or {"status": "error", "reason": …}
    grasps           moveit_msgs/Grasp one for each answer, the best first; late subscribers get them too
    hand_trajectory  trajectory_msgs/JointTrajectory  of the best answer, for the hand's motors or its driver
    arm_trajectory   trajectory_msgs/JointTrajectory  of the arm on the same clock, if an arm is given

Nothing moves by itself. To execute, first bring the arm to the first point of ``arm_trajectory`` with your
motion planner, and remap the two topics to ``/CONTROLLER/joint_trajectory``.
"""

import json
import shlex

import rclpy
from moveit_msgs.msg import Grasp
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

import preshape
from preshape.export.drivers import load_driver
from preshape.export.moveit import MoveItOptions, moveit_grasps
from preshape.export.planned import planned_grasps
from preshape.export.ros_bag import serialised
from preshape.export.trajectory import arm_message, motor_trajectory, trajectory_message
from preshape.planning.document import plan_to_json
from preshape.planning.keywords import request_from_keywords

PLANNING = {"hand": "shadow", "table": "", "count": 3, "mass": 0.0, "friction": 0.0,
            "arm": "", "arm_tip": "", "mount": "", "base_pose": ""}  # fmt: skip
"""Parameters that go to ``preshape.plan``; empty and 0 leave a keyword out. Poses are seven numbers."""
EXPORT = {"frame": "object", "parent_link": "", "driver": "", "memory": ""}
TYPES = {"grasps": Grasp, "hand_trajectory": JointTrajectory, "arm_trajectory": JointTrajectory}


class GraspNode(Node):
    """Answers one request after the other; a request takes from milliseconds (learnt) to seconds (new)."""

    def __init__(self):
        super().__init__("preshape")
        for name, default in (PLANNING | EXPORT).items():
            self.declare_parameter(name, default)
        self.session = preshape.Session(self.of("memory") or None)
        kept = QoSProfile(
            depth=50, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
        )
        self.out = {name: self.create_publisher(kind, f"~/{name}", kept) for name, kind in TYPES.items()}
        self.out["plan"] = self.create_publisher(String, "~/plan", kept)
        self.create_subscription(String, "~/request", self.asked, 10)

    def of(self, name):
        """The value of a parameter."""
        return self.get_parameter(name).value

    def asked(self, message):
        """Plan what a message asks for, and publish the answers."""
        try:
            plan = self.session.run(self.request(message.data))
            document = plan_to_json(plan)
            self.say(document)
            if plan.answer is not None:
                self.publish(document)
            self.get_logger().info(f"{document['status']}: {document['reason']}")
        except preshape.PreshapeError as error:
            self.say({"status": "error", "reason": str(error)})
            self.get_logger().error(str(error))

    def request(self, text):
        """The request of a text; the node's parameters fill in what it leaves out."""
        given = {name: self.of(name) for name in PLANNING if self.of(name)}
        for name in ("mount", "base_pose"):
            if name in given:
                given[name] = [float(part) for part in given[name].split()]
        try:
            if text.lstrip().startswith("{"):
                asked = json.loads(text)
            else:
                asked = dict(zip(("object", "task"), shlex.split(text), strict=True))
        except ValueError as error:
            raise preshape.InputError(f'a request is "OBJECT TASK" or JSON; got {text[:60]!r}') from error
        return request_from_keywords(given | asked)

    def publish(self, document):
        """Publish the grasps of a plan, and the trajectory of the best that can be executed."""
        grasps, _ = planned_grasps(document, "the plan")
        link = self.of("parent_link")
        options = MoveItOptions(frame=self.of("frame"), parent_link=link, mount=self.mount())
        for message in moveit_grasps(grasps, options):
            self.send("grasps", message, "moveit_msgs/msg/Grasp")
        driver = load_driver(self.of("driver")) if self.of("driver") else None
        trajectory = motor_trajectory(grasps[0], driver)
        kind = "trajectory_msgs/msg/JointTrajectory"
        self.send("hand_trajectory", trajectory_message(trajectory), kind)
        arm = arm_message(trajectory)
        if arm is not None:
            self.send("arm_trajectory", arm, kind)

    def mount(self):
        """The hand's pose on the robot's link, if ``parent_link`` names one that is the arm's tip."""
        mount = self.of("mount") if self.of("parent_link") == self.of("arm_tip") else ""
        return [float(part) for part in mount.split()] if mount else None

    def send(self, topic, message, kind):
        """Publish a message that is a dictionary; rclpy takes serialised messages as they are."""
        self.out[topic].publish(serialised(message, kind))

    def say(self, document):
        """Publish a plan, or an error."""
        self.out["plan"].publish(String(data=json.dumps(document)))


def main():
    """Run the node until it is stopped."""
    rclpy.init()
    node = GraspNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.session.close()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
