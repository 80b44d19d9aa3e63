"""Messages in ROS 2 serialisation: a bag folder that ``ros2 bag`` plays, or one MCAP file.

This module needs the package ``rosbags`` (extra ``ros``), but not ROS. The field lists of the two MoveIt
messages are those of moveit_msgs (BSD 3-Clause, copyright 2008-2013 Willow Garage, Inc.); ``rosbags`` has the
messages inside them. The same grasps give the same messages at any time.
"""

from __future__ import annotations

import shutil
import tempfile
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from ..exceptions import EnvironmentFailure, InputError

GRASP = "moveit_msgs/msg/Grasp"
TOPIC = "/preshape/grasps"
VERSION: Final = 8
"""Version of the bag's metadata: the newest that ROS 2 Humble reads; later ROS versions read it too."""
START, STEP = 1_000_000_000, 1_000_000
"""Time stamp of the first message, and time between two messages [ns]."""

FIELDS = {
    "moveit_msgs/msg/GripperTranslation": (
        "geometry_msgs/Vector3Stamped direction",
        "float32 desired_distance",
        "float32 min_distance",
    ),
    GRASP: (
        "string id",
        "trajectory_msgs/JointTrajectory pre_grasp_posture",
        "trajectory_msgs/JointTrajectory grasp_posture",
        "geometry_msgs/PoseStamped grasp_pose",
        "float64 grasp_quality",
        "moveit_msgs/GripperTranslation pre_grasp_approach",
        "moveit_msgs/GripperTranslation post_grasp_retreat",
        "moveit_msgs/GripperTranslation post_place_retreat",
        "float32 max_contact_force",
        "string[] allowed_touch_objects",
    ),
}


@cache
def typestore() -> Any:
    """Type store of ``rosbags`` with ROS 2 Humble's messages and MoveIt's ``Grasp``, shared by all callers.

    Raises:
        EnvironmentFailure: ``rosbags`` is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise EnvironmentFailure(
            'bags and MCAP files need the package rosbags: pip install "preshape[ros]"; YAML needs nothing'
        ) from error
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, lines in FIELDS.items():
        store.register(get_types_from_msg("\n".join(lines), name))
    return store


def serialised(message: dict[str, Any], kind: str = GRASP) -> bytes:
    """A message in CDR, little-endian.

    Args:
        message: Nested dictionaries with every field of the message type.
        kind: Message type.
    """
    store = typestore()
    return bytes(store.serialize_cdr(_filled(store, kind, message), kind, little_endian=True))


def write_mcap(path: Path, messages: list[dict[str, Any]]) -> None:
    """Write grasps as one MCAP file, completely or not at all; an existing file is replaced.

    Raises:
        EnvironmentFailure: ``rosbags`` is not installed, or the file cannot be written.
    """
    _write(path, messages, alone=True)


def write_bag(path: Path, messages: list[dict[str, Any]]) -> None:
    """Write grasps as a ROS 2 bag: a folder with ``metadata.yaml`` and SQLite files, all of it or nothing.

    Raises:
        InputError: A file or folder of that name already exists.
        EnvironmentFailure: ``rosbags`` is not installed, or the folder cannot be written.
    """
    if path.exists():
        raise InputError(f"{path} exists already and a bag is a folder of its own; give another name")
    _write(path, messages, alone=False)


def _write(path: Path, messages: list[dict[str, Any]], *, alone: bool) -> None:
    store = typestore()
    from rosbags.rosbag2 import StoragePlugin, Writer

    data = [serialised(message) for message in messages]
    beside = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        beside = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.stem}-"))
        # The writer names the files in the folder after the folder.
        folder = beside / (path.stem if alone else path.name)
        plugin = StoragePlugin.MCAP if alone else StoragePlugin.SQLITE3
        with Writer(folder, version=VERSION, storage_plugin=plugin) as writer:
            connection = writer.add_connection(
                TOPIC, GRASP, typestore=store, offered_qos_profiles=[_latched(len(data))]
            )
            for number, content in enumerate(data):
                writer.write(connection, START + number * STEP, content)
        (folder / f"{path.stem}.mcap" if alone else folder).replace(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise EnvironmentFailure(f"cannot write {path}: {reason}; choose another folder") from error
    finally:
        if beside is not None:
            shutil.rmtree(beside, ignore_errors=True)


def _latched(depth: int) -> Any:
    """The QoS profile "reliable, transient local": a node that subscribes late still gets every grasp."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    never = QosTime(0, 0)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=depth,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL,
        deadline=never,
        lifespan=never,
        liveliness=QosLiveliness.SYSTEM_DEFAULT,
        liveliness_lease_duration=never,
        avoid_ros_namespace_conventions=False,
    )


def _filled(store: Any, kind: str, content: dict[str, Any]) -> Any:
    """A message of the type store, from nested dictionaries."""
    fields = {}
    for name, (node, detail) in store.fielddefs[kind][1]:
        fields[name] = _field(store, int(node), detail, content[name])
    if len(fields) != len(content):
        raise InputError(f"{kind} has no field {', '.join(sorted(set(content) - set(fields)))}")
    return store.types[kind](**fields)


def _field(store: Any, node: int, detail: Any, content: Any) -> Any:
    from rosbags.interfaces import Nodetype

    if node == Nodetype.BASE:
        return content
    if node == Nodetype.NAME:
        return _filled(store, detail, content)
    (inner, name), _ = detail
    if inner == Nodetype.NAME:
        return [_filled(store, name, item) for item in content]
    return list(content) if name[0] == "string" else np.array(content, dtype=name[0])
