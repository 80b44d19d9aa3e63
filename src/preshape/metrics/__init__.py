"""Metrics of a grasp from its contacts, each with a status; see ``docs/metrics.md``."""

from .closure import force_closure, force_closure_linear
from .contacts import Contacts, cone_matrix, generators, grasp_matrix, support, tangents
from .force_program import ForceLimits
from .gap import force_directions, tdg_gap
from .hull import NORMS, epsilon, volume
from .matrix import isotropy, smallest_singular_value
from .pushes import push_residual, six_pushes
from .results import ForceClosure, Measure, MetricStatus
from .task_margin import HALF_ANGLE, task_margin

__all__ = [
    "HALF_ANGLE",
    "NORMS",
    "Contacts",
    "ForceClosure",
    "ForceLimits",
    "Measure",
    "MetricStatus",
    "cone_matrix",
    "epsilon",
    "force_closure",
    "force_closure_linear",
    "force_directions",
    "generators",
    "grasp_matrix",
    "isotropy",
    "push_residual",
    "six_pushes",
    "smallest_singular_value",
    "support",
    "tangents",
    "task_margin",
    "tdg_gap",
    "volume",
]
