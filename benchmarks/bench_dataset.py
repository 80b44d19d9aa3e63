"""Datasets: grasps per second of one process and of two, with physics, and what 1000 cores would give.

The times are those of one grasp, so that less is better as everywhere in this table. A rate is that of the
steady state: number of processes over the mean time of a shard, the first shard of each process left out
(it loads libraries and caches). Both runs must write the same bytes, every row must be there, and most grasps
must hold: else the answer is wrong.
"""

from __future__ import annotations

import json
import os
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

from .common import row

CASES = tuple(Case(name=f"{name}@1", source=name, scale=1.0) for name in ("box", "cube"))
HAND, TASK = "allegro", "lift"
SETTINGS = DatasetSettings(per=12, per_shard=4)
MANY = 1000
"""Cores of the estimate."""
LEAST_HELD = 0.8
"""Share of the planner's grasps that hold; far more do."""


def run() -> list[dict[str, Any]]:
    with TemporaryDirectory(prefix="preshape-bench-") as folder:
        one, two = (_made(Path(folder) / str(workers), workers) for workers in (1, 2))
        ok = _shards(one) == _shards(two) and all(_right(report) for report in (one, two))
        alone, both, busy = _seconds(one), _seconds(two), _seconds(one, "processor")
        keeping = _keeping(Path(folder) / "kept", one)
    cores = len(os.sched_getaffinity(0))
    rate = 1 / alone
    fed = SETTINGS.per_shard / (keeping * rate)  # cores that one driver keeps busy
    many = min(MANY, fed) * rate
    scaling = f"{2 * alone / both:.2f} times one ({cores} cores here)"
    return [
        row(f"dataset, one process: {rate:.2f} grasps/s", 1e3 * alone, "ms", None, _wall(one, busy), ok),
        row(f"dataset, two processes: {2 / both:.2f} grasps/s", 1e3 * both / 2, "ms", None, scaling, ok),
        row("dataset, driver: reading, writing and logging a shard", 1e3 * keeping, "ms", None, None, ok),
        row(
            f"dataset, {MANY} cores, estimated: {many:.0f} grasps/s, {3600 * many / 1e6:.2f} million an hour",
            1e3 / many,
            "ms",
            None,
            f"assumed: each core as fast as one process alone here; one driver feeds {fed:.0f} cores",
            ok,
        ),
    ]


def _made(out: Path, workers: int) -> DatasetReport:
    return run_dataset(CASES, [HAND], [TASK], out, engine=LocalEngine(workers=workers), settings=SETTINGS)


def _shards(report: DatasetReport) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in (report.folder / "shards").iterdir()}


def _right(report: DatasetReport) -> bool:
    import pyarrow.parquet as pq

    rows = pq.read_table(report.folder / "shards").num_rows
    whole = rows == report.total("rows") == report.total("hold_tested") >= 0.8 * report.total("asked")
    return whole and report.total("held") >= LEAST_HELD * rows


def _seconds(report: DatasetReport, what: str = "total") -> float:
    """Mean seconds that a process needs for a grasp, its first shard left out."""
    started: set[int] = set()
    spent, grasps = 0.0, 0
    for text in (report.folder / "log.jsonl").read_text().splitlines():
        line = json.loads(text)
        if line["process"] in started:
            spent, grasps = spent + line["seconds"][what], grasps + line["rows"]
        started.add(line["process"])
    return spent / grasps


def _keeping(out: Path, report: DatasetReport) -> float:
    """Seconds that the run's own process needs for a shard: what no further core makes faster."""
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
    whole = f"{report.total('rows')} grasps in {report.seconds:.0f} s, start included"
    return f"{whole}; {1e3 * busy:.0f} ms a grasp of the core's own time"
