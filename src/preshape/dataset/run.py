"""Makes a dataset: lists its shards, makes the missing ones, and writes each when it is finished."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from ..exceptions import EnvironmentFailure
from ..planning.planner_bench import Case, Progress
from ..types import value
from .engines import Engine
from .folder import DatasetFolder, manifest
from .schema import arrow
from .settings import DatasetSettings, list_shards


@value
class DatasetReport:
    """Content of a dataset's folder after a run.

    Attributes:
        folder: The folder.
        facts: Facts of each shard, in the order of the shard list.
        made: Number of shards made by this run.
        damaged: Number of shards made again by this run because their files were damaged.
        seconds: Time of this run [s].
    """

    folder: Path
    facts: tuple[dict[str, Any], ...]
    made: int
    damaged: int
    seconds: float

    def total(self, name: str) -> int:
        """Sum of one fact, such as ``asked``, ``rows`` or ``held``, over all shards."""
        return sum(int(facts[name]) for facts in self.facts)

    def short(self) -> list[dict[str, Any]]:
        """``shard``, ``asked``, ``rows`` and ``reason`` of each shard with fewer grasps than requested."""
        shown = ("shard", "asked", "rows", "reason")
        return [{name: f[name] for name in shown} for f in self.facts if f["rows"] < f["asked"]]

    def to_json(self) -> dict[str, Any]:
        """The report as plain JSON values."""
        names = ("asked", "rows", "hold_tested", "held", "task_tested", "task_done")
        return {
            "status": "answer" if self.total("rows") else "no_answer",
            "out": str(self.folder),
            "shards": len(self.facts),
            "made": self.made,
            "damaged": self.damaged,
            **{name: self.total(name) for name in names},
            "seconds": self.seconds,
            "short": self.short(),
        }


def run_dataset(
    cases: Sequence[Case],
    hands: Sequence[str],
    tasks: Sequence[str],
    out: str | Path,
    *,
    engine: Engine,
    settings: DatasetSettings | None = None,
    progress: Progress | None = None,
) -> DatasetReport:
    """Make a dataset, or the missing shards of an unfinished one.

    Args:
        cases: Objects at their scales.
        hands: Hand names or TOML files.
        tasks: Task names, or six numbers separated by blanks.
        out: The folder.
        engine: The engine that makes the shards.
        settings: Settings of the dataset.
        progress: Called after each object that was read and each shard that was made.

    Raises:
        InputError: An argument is not valid, or the folder contains another dataset.
        EnvironmentFailure: A file cannot be read or written, a package is missing, or workers were killed.
    """
    start = time.perf_counter()
    arrow()
    settings = settings or DatasetSettings()
    shards = list_shards(cases, hands, tasks, settings, progress)
    with DatasetFolder(Path(out), manifest(shards, settings)) as folder:
        done: dict[str, dict[str, Any]] = {}
        damaged = 0
        for shard in shards:
            facts = folder.facts(shard.name)
            if facts is not None:
                done[shard.name] = facts
            else:
                damaged += folder.file(shard.name).exists()
        missing = [shard for shard in shards if shard.name not in done]
        if progress is not None:
            progress("shards made", len(done), len(shards))
        faults: dict[str, str] = {}
        with closing(engine.make(missing, settings)) as coming:
            for made in coming:
                if made.fault:
                    faults[made.name] = made.fault
                    continue
                folder.store(made)
                done[made.name] = made.facts
                if progress is not None:
                    progress("shards made", len(done), len(shards))
    if faults:
        name, fault = min(faults.items())
        raise EnvironmentFailure(
            f"internal error in {len(faults)} of {len(shards)} shards, for example in {name} ({fault}); the "
            "other shards are kept and the same command tries these again; PRESHAPE_DEBUG=1 shows the "
            "traceback, please report it"
        )
    return DatasetReport(
        folder=Path(out),
        facts=tuple(done[shard.name] for shard in shards),
        made=len(missing),
        damaged=damaged,
        seconds=time.perf_counter() - start,
    )
