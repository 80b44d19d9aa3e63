"""The experiments of ``preshape reproduce`` and the studies ``preshape bench indices|learning|clouds``.

:mod:`.run` runs the experiments of ``preshape reproduce`` and writes their report. Each experiment is one
module, which measures plain JSON values and presents them. :mod:`.printed` has the paper's numbers,
:mod:`.setup` the common parts of the experiments. The studies of ``preshape bench`` are :mod:`.indices`,
:mod:`.closure_learning` and :mod:`.partial_views`.
"""

from __future__ import annotations

from .experiment import Progress
from .run import EXPERIMENTS, ReportResult, run_all

__all__ = ["EXPERIMENTS", "Progress", "ReportResult", "run_all"]
