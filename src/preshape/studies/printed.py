"""The numbers printed in the paper; ``None`` if the scan is illegible."""

from __future__ import annotations

from typing import Final, NamedTuple, TypeAlias

Q1: Final = (1.0, 1.0, 0.1, 0.05, 0.8, 0.05)
"""Table 1: rotation about the opposition axis of plane 5."""
Q2: Final = (1.0, 1.0, 0.1, 0.8, 0.05, 0.05)
"""Table 1: rotation about the approach axis of plane 5, which is the opposition axis of plane 6."""

ERRORS: Final = (2.5e-3, 1.0e-3, 5.0e-4)
"""Table 4: mean-square errors for which the paper gives epochs and times."""

TABLE_4: Final = (
    ((8424, 72), (15864, 85), (28032, 145)),
    ((6960, 66), (13272, 75), (30240, 170)),
    ((9432, 89), (17832, 105), (38184, 210)),
)
"""Table 4: (epochs, seconds) at each error, for three runs."""


class TaskRow(NamedTuple):
    """One row of fig. 11, 12 or 13: task Q, and plane, approach value, TFVADI and mode of the answer."""

    task: tuple[float, ...]
    plane: int
    value: float
    tfvadi: float
    mode: int


FIG_11: Final = (
    TaskRow((0.09, 0.96, 0.93, 0.20, 0.83, 0.24), 7, 0.1, 4.09, 0),
    TaskRow((1.48, 1.28, 0.05, 0.84, 0.05, 0.05), 6, 0.04, 3.6, 1),
    TaskRow((1.04, 0.92, 1.11, 0.79, 0.94, 0.65), 5, 0.01, 5.31, 2),
)
FIG_12: Final = (
    TaskRow((1.31, 0.76, 0.11, 0.86, 0.07, 0.07), 5, 0.13, 3.78, 3),
    TaskRow((1.05, 0.13, 0.96, 0.84, 0.05, 0.05), 10, 0.02, 3.6, 1),
    TaskRow((1.03, 0.05, 1.15, 0.05, 0.05, 0.91), 9, 0.01, 4.0, 0),
)
"""If the paper's text and table differ, these are the numbers of the text: mode 3 of case 1 (table: 2), and
TFVADI 3.6 of case 2 (table: 2.6)."""

FIG_13: Final = (
    TaskRow((1.08, -1.0, 0.05, 0.05, -0.8, 0.05), 11, 0.01, 5.89, 3),
    TaskRow((1.01, 0.97, 0.05, 0.05, 0.85, 0.05), 5, 0.22, 4.0, 1),
    TaskRow((0.75, 0.1, 0.96, 0.07, 0.1, 0.76), 7, -0.03, 3.0, 1),
)
"""The TFVADI of case 1 is from the paper's text (table: 5.3)."""


class CoefficientRow(NamedTuple):
    """One row of fig. 14: coefficients Ka Ko Kn Mn, TFVADI, and net wrench."""

    coefficients: tuple[float, float, float, float]
    tfvadi: float | None
    wrench: tuple[float, ...]


FIG_14: Final = (
    CoefficientRow((0.30, 0.20, 1.0, 0.90), None, (0.86, 1.1, -0.22, -0.03, 0.96, 0.06)),
    CoefficientRow((0.45, 0.30, 1.0, 0.80), 3.71, (1.3, 1.1, -0.27, 0.06, 0.86, 0.11)),
    CoefficientRow((0.55, 0.35, 1.0, 0.75), None, (2.1, 1.2, -0.49, 0.38, 0.71, 0.2)),
)
"""The TFVADI of rows 1 (3.?1) and 3 is illegible. Fig. 16 prints row 2 with a negative torque about X."""

FIG_14_PLANE, FIG_14_VALUE = 5, 0.01


class ThresholdRow(NamedTuple):
    """One row of fig. 15: estimation threshold, and the answer."""

    threshold: float
    plane: int
    value: float
    tfvadi: float
    mode: int
    wrench: tuple[float, ...]


FIG_15: Final = (
    ThresholdRow(3.0, 7, -0.1, 3.25, 0, (0.27, 1.0, 2.7, -0.11, 0.82, 1.2)),
    ThresholdRow(3.5, 7, 0.09, 3.77, 1, (0.36, 1.1, 2.7, -0.2, 0.88, -0.61)),
    ThresholdRow(3.9, 7, 0.08, 5.74, 2, (0.27, 1.1, 1.3, -0.18, 0.87, 0.05)),
    ThresholdRow(4.2, 7, 0.08, 5.74, 2, (0.27, 1.1, 1.3, -0.18, 0.87, 0.05)),
)


class MembershipRow(NamedTuple):
    """One row of fig. 16: the changed membership functions, and the answer."""

    label: str
    changes: dict[str, tuple[float, float, float, float]]
    mode: int
    plane: int
    value: float
    tfvadi: float | None
    wrench: tuple[float, ...]


Golden: TypeAlias = tuple[
    str, tuple[float, ...], dict[str, tuple[float, float, float, float]], float | None, float
]

USUAL_WRENCH: Final = (1.3, 1.1, -0.27, -0.06, 0.86, 0.11)
"""Fig. 16: the net wrench of all rows except the first."""


def _mirrored(
    name: str, a: float, b: float, c: float, d: float
) -> dict[str, tuple[float, float, float, float]]:
    return {f"FWD-{name}": (a, b, c, d), f"RWD-{name}": (-d, -c, -b, -a)}


FIG_16: Final = (
    MembershipRow(
        "ZERO narrow", {"ZERO": (-0.08, -0.03, 0.03, 0.08)}, 2, 5, 0.15, 6.0,
        (-0.48, 0.82, -0.2, 1.0, 0.5, 0.03),
    ),
    MembershipRow("ZERO wide", {"ZERO": (-0.15, -0.08, 0.08, 0.15)}, 0, 5, 0.01, 3.98, USUAL_WRENCH),
    MembershipRow("L narrow", _mirrored("L", 0.08, 0.15, 0.25, 0.4), 0, 5, 0.01, None, USUAL_WRENCH),
    MembershipRow("L wide", _mirrored("L", 0.05, 0.15, 0.4, 0.6), 0, 5, 0.01, 3.98, USUAL_WRENCH),
    MembershipRow("M narrow", _mirrored("M", 0.35, 0.55, 0.7, 0.9), 0, 5, 0.01, None, USUAL_WRENCH),
    MembershipRow("M wide", _mirrored("M", 0.35, 0.45, 0.85, 0.95), 0, 5, 0.01, None, USUAL_WRENCH),
    MembershipRow("H narrow", _mirrored("H", 0.85, 0.9, 1.2, 1.2), 0, 5, 0.01, None, USUAL_WRENCH),
)  # fmt: skip
"""The TFVADI of four rows is illegible. L, M and H stand for the sets of both signs."""

GOLDEN: Final[tuple[Golden, ...]] = (
    ("fig. 14 row 2", (1.3, 1.1, -0.27, 0.06, 0.86, 0.11), {}, 3.71, 3.700),
    ("fig. 16, ZERO wide", USUAL_WRENCH, FIG_16[1].changes, 3.98, 3.9714),
    ("fig. 16, ZERO narrow", USUAL_WRENCH, FIG_16[0].changes, None, 2.800),
    ("fig. 16, M wide", USUAL_WRENCH, FIG_16[5].changes, None, 4.200),
    ("fig. 14 row 1", FIG_14[0].wrench, {}, None, 3.967),
)
"""Origin, net wrench, changed sets, the paper's TFVADI, and the exact TFVADI."""

ODD_RATE: Final = 0.15
"""Figs. 17 and 18: rate of odd cases."""
ODD_EXPERIMENTS: Final = 500
"""Figs. 17 and 18: number of experiments."""
