"""The study of :mod:`.descriptor_study` as an experiment of the report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .bench import Bench
from .descriptor_study import QUICK_OBJECTS, RESAMPLES, SEEDS, Comparison, Share, compare
from .report import Chapter, write_report
from .values import Cell, Data, Experiment, Progress, Section, Table

_TOLD = {
    "paper": "task, extents, four counts (the paper's 13)",
    "shape": "task, extents, shape descriptor (37)",
    "extents": "task, extents (9)",
    "task": "task alone (6)",
}


def _measure(bench: Bench, part: Path, progress: Progress) -> Data:
    quick = {"objects": QUICK_OBJECTS, "tasks": 2, "folds": 2, "seeds": (bench.seed,)}
    full = {"seeds": tuple(bench.seed + seed for seed in SEEDS)}
    found = compare(bench, progress=progress, **(quick if bench.quick else full))
    return as_data(found)


def as_data(found: Comparison) -> Data:
    """A comparison as plain JSON values; a share is [mean, low, high]."""

    def plain(share: Share) -> list[float]:
        return [share.mean, share.low, share.high]

    columns = ("mode_0", "mode_1", "same_plane", "learnt", "recut")
    return {
        "objects": found.objects,
        "pairs": found.pairs,
        "folds": found.folds,
        "seeds": list(found.seeds),
        "told": {one.name: {column: plain(getattr(one, column)) for column in columns} for one in found.told},
        "gain_0": plain(found.gain_0),
        "gain_1": plain(found.gain_1),
        "possible": plain(found.possible),
    }


def _percent(share: Sequence[float]) -> str:
    mean, low, high = (100 * number for number in share)
    return f"{mean:.1f} ({low:.1f} to {high:.1f})"


def _verdict(gain: Sequence[float]) -> str:
    _, low, high = gain
    if low > 0:
        return "the descriptor is better"
    if high < 0:
        return "the paper's attributes are better"
    return "no difference can be told from chance"


def _present(data: Data) -> Section:
    rows: list[tuple[Cell, ...]] = [
        (_TOLD[name], *(_percent(shares[column]) for column in shares))
        for name, shares in data["told"].items()
    ]
    gain_0, gain_1 = data["gain_0"], data["gain_1"]
    zero, recut = (
        {name: 100 * shares[column][0] for name, shares in data["told"].items()}
        for column in ("mode_0", "recut")
    )
    seeds = ", ".join(map(str, data["seeds"]))
    return Section(
        headline=f"Of tasks on objects never met, mode 0 answers {zero['paper']:.0f} % told the paper's "
        f"attributes and {zero['shape']:.0f} % told the shape descriptor: {_verdict(gain_0)}. Once their "
        f"surface is cut finer, of objects learnt {recut['paper']:.0f} % and {recut['shape']:.0f} %.",
        text=(
            f"{data['objects']} library objects in {data['folds']} parts, each held out once while the "
            f"estimator is trained on the others; {data['pairs']} pairs of object and task, seeds {seeds}. "
            "A pair counts as answered where TFVADI meets the threshold. Intervals are 95 %, from drawing "
            f"whole objects anew {RESAMPLES} times. Some plane has a virtual grasp good enough for "
            f"{_percent(data['possible'])} % of the pairs: more cannot be reached.",
            f"Descriptor less attributes, pair by pair: {_percent(gain_0)} points at mode 0 "
            f"({_verdict(gain_0)}), {_percent(gain_1)} at modes 0 and 1 ({_verdict(gain_1)}).",
        ),
        tables=(
            Table(
                caption="Share of pairs in per cent, with 95 % interval. The first three columns ask about "
                "objects held out, the last two about objects learnt, with tasks that were taught and can be "
                "recalled.",
                columns=(
                    "what the estimator is told", "answered at mode 0", "at mode 0 or 1",
                    "on the plane that would be taught", "learnt, mode 0", "learnt, cut four times finer",
                ),
                rows=tuple(rows),
            ),
        ),
        pictures=(),
        disagreements=(),
    )  # fmt: skip


def report(found: Comparison, out: Path) -> Path:
    """Write a comparison to ``out`` as Markdown and HTML; returns the Markdown file.

    Raises:
        EnvironmentFailure: a file cannot be written.
    """
    chapter = Chapter(name=DESCRIPTOR.name, title=DESCRIPTOR.title, section=_present(as_data(found)))
    return write_report(out, [f"Hand utah_mit, ray analyser; {len(found.seeds)} seeds."], [chapter])[0]


DESCRIPTOR = Experiment(
    name="descriptor", title="What the estimator is told: seven attributes or a shape descriptor",
    version=1, cost=200, measure=_measure, present=_present,
)  # fmt: skip
