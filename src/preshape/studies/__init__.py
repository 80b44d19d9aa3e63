"""``preshape reproduce``: the paper's results beside ours, as one report.

One module an experiment; each measures (plain JSON values, kept on disk) and presents (tables, plots, and a
sentence on every disagreement). :mod:`.printed` has the paper's numbers, :mod:`.bench` what all stand on,
:mod:`.run` the order and the resuming, :mod:`.report` the two forms of the report.
"""

from __future__ import annotations

from .run import EXPERIMENTS, ReportResult, run_all
from .values import Progress as ProgressCallback

__all__ = ["EXPERIMENTS", "ProgressCallback", "ReportResult", "run_all"]
