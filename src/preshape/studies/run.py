"""All experiments, one after the other: measured once, kept as JSON, told in one report."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from .._version import __version__
from ..exceptions import EnvironmentFailure, InputError
from ..files import dumps, write_json
from ..types import value
from .bench import Bench
from .cases import FIG_11, FIG_12, FIG_13
from .contradictions import CONTRADICTIONS
from .descriptor_report import DESCRIPTOR
from .fig_14 import FIG_14
from .fig_15 import FIG_15
from .fig_16 import FIG_16
from .learning_study import LEARNING
from .odd_report import ODD_CASES
from .report import Chapter, write_report
from .table_4 import TABLE_4
from .values import Data, Experiment, Measurement, Progress

_ALL: tuple[Experiment, ...] = (
    TABLE_4, FIG_11, FIG_12, FIG_13, FIG_14, FIG_15, FIG_16, ODD_CASES, LEARNING, DESCRIPTOR,
    CONTRADICTIONS,
)  # fmt: skip

EXPERIMENTS: dict[str, str] = {experiment.name: experiment.title for experiment in _ALL}
"""Name and title of each experiment, in the order of the report."""

_EDGES = ("studies", "viewer", "cli", "schema")
"""Parts of the package that no measurement depends on."""


@value
class ReportResult:
    """What :func:`run_all` wrote.

    Attributes:
        markdown: the report.
        html: the same, with its pictures inside.
        measured: names of the experiments that were run.
        kept: names of those that an earlier run had finished.
    """

    markdown: Path
    html: Path
    measured: tuple[str, ...]
    kept: tuple[str, ...]


def run_all(
    out: Path,
    *,
    only: Sequence[str] | None = None,
    seed: int = 0,
    quick: bool = False,
    resume: bool = True,
    progress: Progress,
) -> ReportResult:
    """Run the experiments and write the report.

    Every finished experiment is ``NAME.json`` in ``out``; stopped at any moment and called again, it goes
    on there (the odd cases within the experiment, after every session). The report has everything in ``out``
    that was measured with these settings and this version.

    Args:
        out: folder of the report; made where it is missing.
        only: names of :data:`EXPERIMENTS`; all by default.
        seed: of everything random; all but the times follows from it.
        quick: a small form of each.
        resume: whether finished experiments are kept.
        progress: called with the fraction done and what is being done; may raise to stop.

    Raises:
        InputError: a name that does not exist, or a negative seed.
        EnvironmentFailure: the folder cannot be written.
    """
    if seed < 0:
        raise InputError(f"the seed must be 0 or more, got {seed}")
    chosen = _chosen(only)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EnvironmentFailure(
            f"cannot make the folder {out}: {error.strerror}; choose another one"
        ) from error
    bench = Bench(seed, quick=quick)
    total = sum(experiment.cost for experiment in chosen) * 1.03  # what is left is the report's
    done, measured, kept = 0.0, [], []
    for experiment in chosen:
        begin, share = done, experiment.cost

        def tell(fraction: float, label: str, *, begin: float = begin, share: float = share) -> None:
            progress((begin + share * min(max(fraction, 0.0), 1.0)) / total, label)

        if resume and _finished(out, experiment, bench) is not None:
            kept.append(experiment.name)
            tell(1.0, f"{experiment.title}: kept")
        else:
            tell(0.0, experiment.title)
            _measure(out, experiment, bench, tell, resume=resume)
            measured.append(experiment.name)
        done += experiment.cost
    progress(done / total, "writing the report")
    chapters = [
        Chapter(name=experiment.name, title=experiment.title, section=experiment.present(found.data))
        for experiment in _ALL
        if (found := _finished(out, experiment, bench)) is not None
    ]
    markdown, html = write_report(out, _preface(bench, len(chapters)), chapters)
    progress(1.0, "done")
    return ReportResult(markdown=markdown, html=html, measured=tuple(measured), kept=tuple(kept))


def _chosen(only: Sequence[str] | None) -> list[Experiment]:
    if only is None:
        return list(_ALL)
    unknown = [name for name in only if name not in EXPERIMENTS]
    if unknown:
        raise InputError(f"no experiment {unknown[0]!r}; known: {', '.join(EXPERIMENTS)}")
    return [experiment for experiment in _ALL if experiment.name in only]


def _preface(bench: Bench, chapters: int) -> list[str]:
    form = (
        "the quick form, for a first look: fewer runs, objects and experiments"
        if bench.quick
        else "the full form"
    )
    part = "" if chapters == len(_ALL) else f" It has {chapters} of {len(_ALL)} experiments so far."
    return [
        f"Results of the paper (HIIS for grasp preshape estimation) beside those of preshape "
        f"{__version__}, seed {bench.seed}, "
        f"{form}.{part} The hand is {bench.hand.name}, U = {1000 * bench.layout.u:.0f} mm. Everything "
        "but the times follows from the seed.",
        "The paper's objects are not published, so objects of the same kind are used; its numbers stand "
        "beside ours as printed, and are not "
        "forced to agree. Under each experiment every disagreement has its sentence, worked out from "
        "the measured numbers.",
    ]


# What is kept.


def _settings(experiment: Experiment, bench: Bench) -> Data:
    return {
        "seed": bench.seed,
        "quick": bench.quick,
        "experiment": experiment.version,
        "package": __version__,
        "code": _fingerprint(),
    }


def _finished(out: Path, experiment: Experiment, bench: Bench) -> Measurement | None:
    """An earlier measurement with these settings, if there is one."""
    path = out / f"{experiment.name}.json"
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise EnvironmentFailure(f"cannot read {path}: {error.strerror}; choose another folder") from error
    except ValueError:
        return None  # not ours, or damaged: measured anew
    settings = _settings(experiment, bench)
    if not isinstance(document, dict) or document.get("settings") != settings or "data" not in document:
        return None
    return Measurement(name=experiment.name, settings=settings, data=document["data"])


def _measure(out: Path, experiment: Experiment, bench: Bench, tell: Progress, *, resume: bool) -> None:
    settings = _settings(experiment, bench)
    mark = hashlib.sha256(dumps(settings).encode()).hexdigest()[:8]
    part = out / f"{experiment.name}.{mark}.part"
    if not resume:
        part.unlink(missing_ok=True)
    data = experiment.measure(bench, part, tell)
    document = {"name": experiment.name, "title": experiment.title, "settings": settings, "data": data}
    write_json(out / f"{experiment.name}.json", document)
    for old in out.glob(f"{experiment.name}.*.part"):
        old.unlink(missing_ok=True)


@cache
def _fingerprint() -> str:
    """Of the code that measurements depend on: an edited package does not keep the old one's numbers."""
    digest = hashlib.sha256()
    for name, file in sorted(_files(resources.files("preshape"), "")):
        digest.update(name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:16]


def _files(folder: Traversable, prefix: str) -> list[tuple[str, Traversable]]:
    out = []
    for entry in folder.iterdir():
        name = f"{prefix}{entry.name}"
        if entry.is_dir():
            if entry.name not in ("__pycache__", *_EDGES):
                out += _files(entry, f"{name}/")
        elif not entry.name.endswith(".pyc"):
            out.append((name, entry))
    return out
