"""A whole dataset: list the shards, make those that are missing, keep each as it comes."""

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
from .folder import Folder, manifest
from .schema import arrow
from .settings import DatasetSettings, list_shards


@value
class DatasetReport:
    """What a folder holds after a run.

    Attributes:
        folder: the dataset.
        facts: of each shard, in the order of the list.
        made: shards that this run made.
        damaged: of these, how many stood there but could not be read.
        seconds: of this run.
    """

    folder: Path
    facts: tuple[dict[str, Any], ...]
    made: int
    damaged: int
    seconds: float

    def total(self, name: str) -> int:
        """Sum of one fact over all shards, such as ``asked``, ``rows`` or ``held``."""
        return sum(int(facts[name]) for facts in self.facts)

    def short(self) -> list[dict[str, Any]]:
        """Shards with fewer grasps than asked for: name, asked, rows, reason."""
        kept = ("shard", "asked", "rows", "reason")
        return [{name: f[name] for name in kept} for f in self.facts if f["rows"] < f["asked"]]

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values."""
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
    """Make a dataset, or what is missing of one.

    Args:
        cases: objects at their scales.
        hands: names or TOML files.
        tasks: names, or six numbers with blanks between.
        out: the folder.
        engine: who makes the shards.
        settings: what decides their content.
        progress: called as work is done.

    Raises:
        InputError: a bad argument, or the folder holds another dataset.
        EnvironmentFailure: a file cannot be read or written, something is missing, or processes were killed.
    """
    start = time.perf_counter()
    arrow()
    settings = settings or DatasetSettings()
    shards = list_shards(cases, hands, tasks, settings, progress)
    with Folder(Path(out), manifest(shards, settings)) as folder:
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
                folder.keep(made)
                done[made.name] = made.facts
                if progress is not None:
                    progress("shards made", len(done), len(shards))
    if faults:
        name, fault = min(faults.items())
        raise EnvironmentFailure(
            f"internal fault in {len(faults)} of {len(shards)} shards, as in {name} ({fault}); the others "
            "stand, the same command tries these again; PRESHAPE_DEBUG=1 shows where, please report it"
        )
    return DatasetReport(
        folder=Path(out),
        facts=tuple(done[shard.name] for shard in shards),
        made=len(missing),
        damaged=damaged,
        seconds=time.perf_counter() - start,
    )
