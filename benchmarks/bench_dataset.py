"""Datasets with physics: grasps per second of one and two processes, and an estimate for 1000 cores.

The table shows the time of one grasp, so that less is better as in every row. A rate is the number of
processes over the mean time of a grasp, without the first shard of each process, which loads libraries and
caches. The answer is right where both runs write the same bytes, no row is missing, and most grasps hold.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from preshape.dataset.engines import LocalEngine
from preshape.dataset.folder import DatasetFolder, manifest
from preshape.dataset.making import MadeShard
from preshape.dataset.run import DatasetReport, run_dataset
from preshape.dataset.settings import DatasetSettings, list_shards
from preshape.planning.planner_bench import Case
from preshape.processes import usable_cores

from .common import row

CASES = tuple(Case(name=f"{name}@1", source=name, scale=1.0) for name in ("box", "cube"))
HAND, TASK = "allegro", "lift"
SETTINGS = DatasetSettings(per=12, per_shard=4)
MANY_CORES = 1000
"""Number of cores of the estimate."""
LEAST_HELD = 0.8
"""Least share of the planner's grasps that hold; usually far more do."""


def run() -> list[dict[str, Any]]:
    with TemporaryDirectory(prefix="preshape-bench-") as folder:
        one, two = (_run(Path(folder) / str(workers), workers) for workers in (1, 2))
        ok = _shards(one) == _shards(two) and all(_right(report) for report in (one, two))
        alone, both, busy = _seconds(one), _seconds(two), _seconds(one, "processor")
        storing = _storing(Path(folder) / "stored", one)
    rate = 1 / alone
    fed = SETTINGS.per_shard / (storing * rate)  # cores that one calling process can serve
    many = min(MANY_CORES, fed) * rate
    scaling = f"{2 * alone / both:.2f} times one ({usable_cores()} cores here)"
    estimate = f"{many:.0f} grasps/s, {3600 * many / 1e6:.2f} million an hour"
    return [
        row(f"dataset, one process: {rate:.2f} grasps/s", 1e3 * alone, "ms", None, _wall(one, busy), ok),
        row(f"dataset, two processes: {2 / both:.2f} grasps/s", 1e3 * both / 2, "ms", None, scaling, ok),
        row("dataset, calling process: check, write and log a shard", 1e3 * storing, "ms", None, None, ok),
        row(
            f"dataset, {MANY_CORES} cores, estimated: {estimate}",
            1e3 / many,
            "ms",
            None,
            f"assumes cores as fast as one process alone here; one calling process serves {fed:.0f} cores",
            ok,
        ),
    ]


def _run(out: Path, workers: int) -> DatasetReport:
    return run_dataset(CASES, [HAND], [TASK], out, engine=LocalEngine(workers=workers), settings=SETTINGS)


def _shards(report: DatasetReport) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in (report.folder / "shards").iterdir()}


def _right(report: DatasetReport) -> bool:
    import pyarrow.parquet as pq

    rows = pq.read_table(report.folder / "shards").num_rows
    whole = rows == report.total("rows") == report.total("hold_tested") >= 0.8 * report.total("asked")
    return whole and report.total("held") >= LEAST_HELD * rows


def _seconds(report: DatasetReport, what: str = "total") -> float:
    """Mean time of a process for one grasp [s], without the first shard of the process."""
    started: set[int] = set()
    spent, grasps = 0.0, 0
    for text in (report.folder / "log.jsonl").read_text().splitlines():
        line = json.loads(text)
        if line["process"] in started:
            spent, grasps = spent + line["seconds"][what], grasps + line["rows"]
        started.add(line["process"])
    return spent / grasps


def _storing(out: Path, report: DatasetReport) -> float:
    """Time of the calling process for one shard [s], which more cores do not reduce."""
    shards = list_shards(CASES, [HAND], [TASK], SETTINGS)
    facts = {f["shard"]: f for f in report.facts}
    stored = _shards(report)
    with DatasetFolder(out, manifest(shards, SETTINGS)) as folder:
        start = time.perf_counter()
        for shard in shards:
            content = stored[f"{shard.name}.parquet"]
            made = MadeShard(
                name=shard.name, content=content, facts=facts[shard.name], seconds={}, process=0, host=""
            )
            folder.facts(shard.name)
            folder.store(made)
        return (time.perf_counter() - start) / len(shards)


def _wall(report: DatasetReport, busy: float) -> str:
    whole = f"{report.total('rows')} grasps in {report.seconds:.0f} s with the start"
    return f"{whole}; {1e3 * busy:.0f} ms of CPU time for each grasp"
