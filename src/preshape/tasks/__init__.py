"""Tasks: motions of the object that the hand must produce (§2.2)."""

from .displacement import (
    compose,
    displacement_of,
    full_motion,
    goal_pose,
    primitives_of,
    q_of_displacement,
    task_from_displacement,
    task_from_poses,
    task_from_primitives,
)
from .families import FAMILIES, OTHER_NAMES, Family, all_named_tasks, family_names, named_task, parse_task
from .task import AXES, Primitive, Task, from_json, motion_of, task_from_numbers, to_json

__all__ = [
    "AXES",
    "FAMILIES",
    "OTHER_NAMES",
    "Family",
    "Primitive",
    "Task",
    "all_named_tasks",
    "compose",
    "displacement_of",
    "family_names",
    "from_json",
    "full_motion",
    "goal_pose",
    "motion_of",
    "named_task",
    "parse_task",
    "primitives_of",
    "q_of_displacement",
    "task_from_displacement",
    "task_from_numbers",
    "task_from_poses",
    "task_from_primitives",
    "to_json",
]
