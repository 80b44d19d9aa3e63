"""Runs all experiments in order: each is measured once and stored as JSON, and one report presents all."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from .._version import __version__
from ..exceptions import EnvironmentFailure, InputError
from ..files import dumps, loads, make_folder, write_json
from ..report import Report, write_report
from ..types import value
from .contradictions import CONTRADICTIONS
from .descriptor_study import DESCRIPTOR
from .eleven import ELEVEN
from .experiment import Experiment, Progress
from .fig_14 import FIG_14
from .fig_15 import FIG_15
from .fig_16 import FIG_16
from .figs_11_13 import FIG_11, FIG_12, FIG_13
from .finger_rules import FINGERS
from .learning_study import LEARNING
from .odd_case_report import ODD_CASES
from .setup import Data, Setup
from .table_4 import TABLE_4

TITLE = "The paper's results, reproduced"

_ALL: tuple[Experiment, ...] = (
    TABLE_4, FIG_11, FIG_12, FIG_13, ELEVEN, FIG_14, FIG_15, FIG_16, ODD_CASES, FINGERS, LEARNING,
    DESCRIPTOR, CONTRADICTIONS,
)  # fmt: skip

EXPERIMENTS: dict[str, str] = {experiment.name: experiment.title for experiment in _ALL}
"""Name and title of each experiment, in the order of the report."""

_NOT_MEASURED = ("studies", "report", "viewer", "cli", "schema")
"""Parts of the package that affect no measured number; experiments have versions of their own."""


@value
class ReportResult:
    """Result of :func:`run_all`.

    Attributes:
        markdown: The report as Markdown.
        html: The report as one HTML page with its figures inside.
        measured: Names of the experiments that were measured.
        reused: Names of the experiments whose stored results were used.
    """

    markdown: Path
    html: Path
    measured: tuple[str, ...]
    reused: tuple[str, ...]


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

    Every finished experiment is stored as ``NAME.json`` in ``out``, so an interrupted run can be resumed. The
    experiments on odd cases are also stored after each of their runs. The report covers all experiments in
    ``out`` that were measured with these settings and this version.

    Args:
        out: Folder of the report; created if it is missing.
        only: Names of :data:`EXPERIMENTS`; all by default.
        seed: Seed of every random draw; the same seed gives the same numbers, apart from times.
        quick: Whether each experiment runs in its small form.
        resume: Whether results of an earlier run are used.
        progress: Called with the completed fraction and the current step.

    Raises:
        InputError: A name does not exist, or the seed is negative.
        EnvironmentFailure: The folder cannot be written.
    """
    if seed < 0:
        raise InputError(f"the seed must be 0 or more, got {seed}")
    chosen = _chosen(only)
    make_folder(out)
    setup = Setup(seed, quick=quick)
    total = sum(experiment.cost for experiment in chosen) * 1.03  # the rest is for writing the report
    done, measured, reused = 0.0, [], []
    for experiment in chosen:
        begin, share = done, experiment.cost

        def tell(fraction: float, label: str, *, begin: float = begin, share: float = share) -> None:
            progress((begin + share * min(max(fraction, 0.0), 1.0)) / total, label)

        if resume and _stored(out, experiment, setup) is not None:
            reused.append(experiment.name)
            tell(1.0, f"{experiment.title}: finished before")
        else:
            tell(0.0, experiment.title)
            _measure(out, experiment, setup, tell, resume=resume)
            measured.append(experiment.name)
        done += experiment.cost
    progress(done / total, "writing the report")
    chapters = tuple(
        experiment.chapter(data)
        for experiment in _ALL
        if (data := _stored(out, experiment, setup)) is not None
    )
    report = Report(title=TITLE, preface=_preface(setup, len(chapters)), chapters=chapters)
    markdown, html = write_report(out, report)
    progress(1.0, "done")
    return ReportResult(markdown=markdown, html=html, measured=tuple(measured), reused=tuple(reused))


def _chosen(only: Sequence[str] | None) -> list[Experiment]:
    if only is None:
        return list(_ALL)
    unknown = [name for name in only if name not in EXPERIMENTS]
    if unknown:
        raise InputError(f"no experiment {unknown[0]!r}; known: {', '.join(EXPERIMENTS)}")
    return [experiment for experiment in _ALL if experiment.name in only]


def _preface(setup: Setup, chapters: int) -> tuple[str, str]:
    form = (
        "in the quick form, with fewer runs, objects and experiments" if setup.quick else "in the full form"
    )
    part = "" if chapters == len(_ALL) else f" It has {chapters} of {len(_ALL)} experiments so far."
    return (
        "This report compares results of the paper (HIIS for grasp preshape estimation) with those of "
        f"preshape {__version__}, seed {setup.seed}, {form}.{part} The hand is {setup.hand.name}, U = "
        f"{1000 * setup.hand.u:.0f} mm. The seed decides all numbers except the times.",
        "The paper's objects are not published, so objects of the same kind are used. Its numbers are given "
        "as printed and are not fitted. Each disagreement is listed under its experiment, with its reason "
        "where the measured numbers show one.",
    )


def _settings(experiment: Experiment, setup: Setup) -> Data:
    """The settings that stored results must have to be used again."""
    return {
        "seed": setup.seed,
        "quick": setup.quick,
        "experiment": experiment.version,
        "package": __version__,
        "code": _fingerprint(),
    }


def _stored(out: Path, experiment: Experiment, setup: Setup) -> Data | None:
    """Results of an earlier run with these settings; ``None`` if there are none.

    Raises:
        EnvironmentFailure: The file cannot be read.
    """
    path = out / f"{experiment.name}.json"
    try:
        document = loads(path.read_text(encoding="utf-8"))
        if document["settings"] == _settings(experiment, setup):
            data: Data = document["data"]
            return data
    except FileNotFoundError:
        pass
    except OSError as error:
        raise EnvironmentFailure(f"cannot read {path}: {error.strerror}; choose another folder") from error
    except (ValueError, KeyError, TypeError):
        pass  # the file is damaged or from another program, so the experiment is measured again
    return None


def _measure(out: Path, experiment: Experiment, setup: Setup, tell: Progress, *, resume: bool) -> None:
    settings = _settings(experiment, setup)
    mark = hashlib.sha256(dumps(settings).encode()).hexdigest()[:8]
    part = out / f"{experiment.name}.{mark}.part"
    if not resume:
        part.unlink(missing_ok=True)
    data = experiment.measure(setup, part, tell)
    document = {"name": experiment.name, "title": experiment.title, "settings": settings, "data": data}
    write_json(out / f"{experiment.name}.json", document)
    for old in out.glob(f"{experiment.name}.*.part"):
        old.unlink(missing_ok=True)


@cache
def _fingerprint() -> str:
    """Hash of the code that affects measured numbers; after a change, old results are not used again."""
    digest, root = hashlib.sha256(), Path(__file__).parents[1]
    for file in sorted(root.rglob("*")):
        name = file.relative_to(root)
        if file.is_file() and "__pycache__" not in name.parts and name.parts[0] not in _NOT_MEASURED:
            digest.update(name.as_posix().encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:16]
