"""Mutation check: which small changes of the code do its tests not notice?

    make mutants                              200 changes of src/preshape/hiis, drawn at random
    make mutants ARGS="fuzzy planes --all"    every change of two modules
    python -m hardening.mutants --help

Steps:

1. Run each test file once under coverage, on a copy of the source: it must pass, and its lines and its
   duration are stored.
2. Draw the mutants (:mod:`hardening.mutations`).
3. For each, run the test files that cover its line, the fastest first, until a test fails. A process that
   takes far longer than before is stopped; that counts as noticed.
4. Write ``mutants.md`` and ``mutants.json`` to ``out/mutants``, also after Ctrl-C.

Only the test files named (``--tests``) are run, so a survivor may still be noticed by another. An
interrupted run is resumed. A mutant that was noticed is not run again while the source is the same; survivors
are, when the tests have changed. ``--fresh`` runs everything again.
"""

from __future__ import annotations

import argparse
import json
import queue
import random
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

from .long_runs import show_progress, stored_rows
from .mutation_copy import Copy, StudyError
from .mutation_report import NOTICED, SAME, UNCOVERED, report, summary
from .mutations import Mutation, mutations

ROOT = Path(__file__).parents[1]
PACKAGE = "preshape/hiis"
TESTS = tuple(
    f"tests/test_{name}.py"
    for name in (
        "planes",
        "fuzzy",
        "estimator",
        "analyser",
        "decision",
        "wrench",
        "critic",
        "training",
        "virtual_grasp",
        "learning",
        "controller",
        "controller_modes",
        "memory_units",
        "why_none",
        "shape_inputs",
        "recalling",
        "outcomes",
        "invariance",
    )
)
"""The tests of the package; the rest of the suite uses it, and takes minutes for each survivor."""

_ODDS = "The odds are divided by their sum, so a common factor has no effect; none of them overflows."
_ZEROS = "The codes begin with zeros there, a common factor; there is no tenth output."
_UNION = "union = np.asarray(wrench_union, dtype=np.float64).reshape(-1, 6)"
_SLACK = "No two scores differ by exactly the slack."
_BETTER = "if discovery.answer.judged > grasp.judged + SLACK:"
_STEP = "At the peak, and within the core, the membership is 1 already."
_FAR = "All that counts is that the limit lies far beyond the shoulders, and its square is no overflow."
_ROUND = "Only the rounding error of a sum of two corners, about 1e-16, is to be removed."
_AXIS = "The largest component of a signed axis is 1 or -1."
_COSINES = "The products of signed axes are -1, 0 and 1."
_LOG = "log = (patterns * np.log(p) + (1 - patterns) * np.log1p(-p)).sum(axis=1)"
_SET = "s = _code_probabilities(outputs[4:7], np.arange(7))"
_FINGERS = "f = _code_probabilities(outputs[7:9], np.arange(1, 4))"
_PEAKS = "peak_low, peak_high = self.corners[0, 2], self.corners[-1, 1]"
_CRISP = "return np.clip(np.round(middle, 12), -CLIP, CLIP)"
_NAME = 'return ("+" if axis[i] > 0 else "-") + "xyz"[i]'
_ALLOWED = "return (APPROACH_AXES @ wanted.T > 0.5).any(axis=1)"
_GRASP = "def grasp(self, index: int = 0) -> Grasp:"
EQUIVALENT: dict[tuple[str, str, str], str] = {
    ("analyser.py", _GRASP, _GRASP.replace("0", "1")): "The method is abstract.",
    ("analyser.py", _GRASP, _GRASP.replace("0", "(-1)")): "The method is abstract.",
    ("estimator.py", _LOG, _LOG.replace("1 - p", "0 - p")): _ODDS,
    ("estimator.py", _LOG, _LOG.replace("1 - p", "2 - p")): _ODDS,
    ("estimator.py", "odds = np.exp(log - log.max())", "odds = np.exp((log + log.max()))"): _ODDS,
    ("estimator.py", "odds = np.exp(log - log.max())", "odds = np.exp(log - (log.min)())"): _ODDS,
    ("estimator.py", _SET, _SET.replace("4:7", "3:7")): _ZEROS,
    ("estimator.py", _FINGERS, _FINGERS.replace("7:9", "6:9")): _ZEROS,
    ("estimator.py", _FINGERS, _FINGERS.replace("7:9", "7:10")): _ZEROS,
    ("fuzzy.py", "inside[0, ...][x <= peak_low] = 1.0", "inside[0, ...][(x < peak_low)] = 1.0"): _STEP,
    ("fuzzy.py", "inside[6, ...][x >= peak_high] = 1.0", "inside[6, ...][(x > peak_high)] = 1.0"): _STEP,
    ("fuzzy.py", _PEAKS, _PEAKS.replace("0, 2", "0, 1")): _STEP,
    ("fuzzy.py", _PEAKS, _PEAKS.replace("-1, 1", "-1, 2")): _STEP,
    ("fuzzy.py", "_FAR = 1e6", "_FAR = 2000000.0"): _FAR,
    ("fuzzy.py", "_FAR = 1e6", "_FAR = 500000.0"): _FAR,
    ("fuzzy.py", _CRISP, _CRISP.replace("12", "11")): _ROUND,
    ("fuzzy.py", _CRISP, _CRISP.replace("12", "13")): _ROUND,
    ("learning.py", _BETTER, "if (discovery.answer.judged >= grasp.judged + SLACK):"): _SLACK,
    ("planes.py", _NAME, _NAME.replace("axis[i] > 0", "(axis[i] >= 0)")): _AXIS,
    ("planes.py", _NAME, _NAME.replace("> 0", "> (-1)")): _AXIS,
    ("planes.py", _ALLOWED, _ALLOWED.replace("0.5", "0.25")): _COSINES,
    ("planes.py", _ALLOWED, "return ((APPROACH_AXES @ wanted.T >= 0.5)).any(axis=1)"): _COSINES,
    ("wrench.py", _UNION, _UNION.replace("-1", "-2")): "NumPy takes any negative length for the unknown one.",
}
"""Mutants that no test can notice: module, line before and after (without indentation), and the reason."""

PATIENCE = (30.0, 8.0)
"""Time until a process is stopped: seconds, plus this many times the duration of its tests."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Project:
    """What is mutated, and by which tests it is judged.

    Attributes:
        root: Folder in which the tests run.
        source: Folder below it that is put on the import path.
        package: Folder below ``source`` whose modules are mutated.
        tests: Test files, relative to ``root``.
        equivalent: As :data:`EQUIVALENT`.
    """

    root: Path = ROOT
    source: str = "src"
    package: str = PACKAGE
    tests: tuple[str, ...] = TESTS
    equivalent: dict[tuple[str, str, str], str] = field(default_factory=lambda: EQUIVALENT)

    @property
    def modules(self) -> dict[str, str]:
        """Text of each module of the package, by file name."""
        folder = self.root / self.source / self.package
        return {file.name: file.read_text(encoding="utf-8") for file in sorted(folder.glob("*.py"))}

    def digest(self) -> str:
        """Digest of the whole source."""
        return _digest(p for p in (self.root / self.source).rglob("*") if p.suffix not in (".pyc", ".pyo"))

    def test_digest(self, *tests: str) -> str:
        """Digest of test files and of what the tests beside them share."""
        files = [self.root / test for test in tests]
        return _digest({*files, *(file.parent / "conftest.py" for file in files)})


@dataclass(frozen=True, slots=True)
class Mutant:
    """A mutation of a module of the package."""

    module: str
    mutation: Mutation
    difference: str

    @property
    def key(self) -> str:
        """Name that stays the same while the module does."""
        m = self.mutation
        return f"{self.module}:{m.line}:{m.start}-{m.end}:{m.text}"

    @property
    def change(self) -> tuple[str, str, str]:
        """Module, text before and text after, without indentation: its name in :data:`EQUIVALENT`."""
        lines = self.difference.splitlines()
        before, after = ("\n".join(x[1:].strip() for x in lines if x[0] == mark) for mark in "-+")
        return self.module, before, after


@dataclass(frozen=True, slots=True)
class Covered:
    """What one test file runs: its duration [s], and its lines in each module."""

    seconds: float
    lines: dict[str, frozenset[int]]


def _digest(files: Iterable[Path]) -> str:
    total = sha256()
    for file in sorted(files):
        if file.is_file():
            total.update(file.name.encode() + b"\0" + file.read_bytes())
    return total.hexdigest()[:16]


def measured(project: Project, copy: Copy, out: Path) -> dict[str, Covered]:
    """What each test file covers, from an earlier run where neither it nor the source has changed since.

    Raises:
        StudyError: A test fails without a mutant.
    """
    from coverage import CoverageData

    source, store = project.digest(), out / "coverage.jsonl"
    known = {row["key"]: row for row in stored_rows(store)}
    found: dict[str, Covered] = {}
    for number, test in enumerate(project.tests, start=1):
        key = f"{source} {test} {project.test_digest(test)}"
        if key not in known:
            show_progress(f"coverage of {test}, {number} of {len(project.tests)}")
            with tempfile.TemporaryDirectory() as folder:
                data = Path(folder) / "data"
                place = copy.folder / project.package
                before = [
                    "-m",
                    "coverage",
                    "run",
                    f"--data-file={data}",
                    f"--include={place}/*",
                    "-m",
                    "pytest",
                ]
                begin = time.monotonic()
                code, output = copy.run([test], 3600.0, before=before)
                seconds = time.monotonic() - begin
                if code != 0:
                    raise StudyError(f"{test} fails without a mutant:\n{output[-2000:]}")
                stored = CoverageData(str(data))
                stored.read()
                lines = {Path(f).name: sorted(stored.lines(f) or ()) for f in stored.measured_files()}
            known[key] = {"key": key, "seconds": round(seconds, 2), "lines": lines}
            with store.open("a") as log:
                log.write(json.dumps(known[key]) + "\n")
        row = known[key]
        found[test] = Covered(row["seconds"], {name: frozenset(n) for name, n in row["lines"].items()})
    return found


def covering(mutant: Mutant, covered: dict[str, Covered]) -> list[str]:
    """The test files that run a line of the mutant's statement, the fastest first."""
    first, last = mutant.mutation.lines
    where = range(first, last + 1)
    tests = [t for t, c in covered.items() if not c.lines.get(mutant.module, frozenset()).isdisjoint(where)]
    return sorted(tests, key=lambda test: covered[test].seconds)


def drawn(project: Project, modules: Sequence[str], count: int | None, seed: int) -> list[Mutant]:
    """Mutants of the modules, in random order, so that an interrupted run is a sample too.

    Raises:
        StudyError: A module does not exist.
    """
    texts = project.modules
    names = [f"{name.removesuffix('.py')}.py" for name in modules] or list(texts)
    if unknown := set(names) - set(texts):
        raise StudyError(f"no module {', '.join(sorted(unknown))}; known: {', '.join(texts)}")
    every = [
        Mutant(name, mutation, mutation.difference(texts[name]))
        for name in names
        for mutation in mutations(texts[name])
    ]
    return random.Random(seed).sample(every, len(every) if count is None else max(0, min(count, len(every))))


def earlier(project: Project, out: Path) -> dict[str, dict[str, Any]]:
    """Rows of earlier runs that still count: the source is the same, and so are the tests, or one failed."""
    source, tests = project.digest(), project.test_digest(*project.tests)
    return {
        row["key"]: row
        for row in stored_rows(out / "mutants.jsonl")
        if row["source"] == source and (row["tests"] == tests or row["outcome"] in NOTICED)
    }


def study(project: Project, mutants: Sequence[Mutant], out: Path, *, workers: int) -> None:
    """Test every mutant that is not equivalent and has no row yet, and store its row as soon as it has one.

    Args:
        project: What is mutated, and the tests.
        mutants: The mutants.
        out: Folder for the rows.
        workers: Test processes at a time.

    Raises:
        StudyError: A test fails without a mutant.
    """
    out.mkdir(parents=True, exist_ok=True)
    done = earlier(project, out)
    todo = [m for m in mutants if m.key not in done and m.change not in project.equivalent]
    asked = {mutant.key for mutant in mutants}
    noticed = sum(row["outcome"] in NOTICED for key, row in done.items() if key in asked)
    texts = project.modules
    same = {"source": project.digest(), "tests": project.test_digest(*project.tests)}
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder, (out / "mutants.jsonl").open("a") as log:
        every = [Copy(project.root, project.source, Path(folder) / str(number)) for number in range(workers)]
        covered = measured(project, every[0], out)
        free: queue.SimpleQueue[Copy] = queue.SimpleQueue()
        for copy in every:
            free.put(copy)

        def one(mutant: Mutant) -> dict[str, Any]:
            row, files = {"key": mutant.key, **same}, covering(mutant, covered)
            if not files:
                return {**row, "outcome": UNCOVERED, "by": "", "seconds": 0.0}
            copy = free.get()
            try:
                most = PATIENCE[0] + PATIENCE[1] * sum(covered[file].seconds for file in files)
                text = mutant.mutation.applied(texts[mutant.module])
                return {**row, **copy.tested(f"{project.package}/{mutant.module}", text, files, most)}
            finally:
                free.put(copy)

        begin = time.monotonic()
        pool = ThreadPoolExecutor(workers)
        try:
            for number, future in enumerate(as_completed([pool.submit(one, m) for m in todo]), start=1):
                row = future.result()
                log.write(json.dumps(row) + "\n")
                log.flush()
                noticed += row["outcome"] in NOTICED
                last = number == len(todo)
                if sys.stderr.isatty() or number % 10 == 0 or last:
                    seconds = (len(todo) - number) * (time.monotonic() - begin) / number
                    left = "" if last else f", about {seconds / 60:.0f} min left"
                    show_progress(f"{number} of {len(todo)} mutants, {noticed} noticed{left}", last=last)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for copy in every:
                copy.stop()
            raise
        finally:
            pool.shutdown()


def tested(project: Project, mutants: Sequence[Mutant], out: Path) -> list[tuple[Mutant, dict[str, Any]]]:
    """The mutants that have an outcome, each with its row."""
    rows = earlier(project, out)
    rows |= {m.key: {"key": m.key, "outcome": SAME} for m in mutants if m.change in project.equivalent}
    return [(mutant, rows[mutant.key]) for mutant in mutants if mutant.key in rows]


def main(arguments: list[str], project: Project | None = None) -> int:
    """Run from the command line; returns 0 after a run, 2 for bad input or failing tests, 130 interrupted."""
    from preshape.exceptions import InputError
    from preshape.files import write_json
    from preshape.processes import process_count
    from preshape.report.markdown import markdown

    parser = argparse.ArgumentParser(prog="python -m hardening.mutants", description="Mutation check.")
    parser.add_argument("modules", nargs="*", help="names of modules; default: all of the package")
    parser.add_argument("--package", default=PACKAGE, help="folder under src; default: %(default)s")
    parser.add_argument("--tests", nargs="+", default=TESTS, metavar="FILE", help="default: the package's")
    parser.add_argument("--count", type=int, default=200, help="mutants to draw; default: %(default)s")
    parser.add_argument("--all", action="store_true", help="test every mutant")
    parser.add_argument("--seed", type=int, default=0, help="of the draw; default: %(default)s")
    parser.add_argument("--workers", type=int, help="processes; default: one for each core")
    parser.add_argument("--fresh", action="store_true", help="do not use results of earlier runs")
    parser.add_argument("--out", type=Path, default=Path("out/mutants"), help="default: %(default)s")
    given = parser.parse_args(arguments)
    project = project or Project(package=given.package, tests=tuple(given.tests))
    try:
        mutants = drawn(project, given.modules, None if given.all else given.count, given.seed)
        if not mutants:
            raise StudyError(f"nothing to change: {project.package} has no code, or --count is under 1")
        workers = min(process_count(given.workers), len(mutants))
        given.out.mkdir(parents=True, exist_ok=True)
        if given.fresh:
            (given.out / "mutants.jsonl").unlink(missing_ok=True)
        study(project, mutants, given.out, workers=workers)
        code = 0
    except (InputError, StudyError) as error:
        print(error, file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\ninterrupted; the same command resumes from here", file=sys.stderr)
        code = 130
    found = tested(project, mutants, given.out)
    how = (
        f"{len(found)} mutants of {len(mutants)}, {'all' if given.all else f'drawn with seed {given.seed}'}."
    )
    (given.out / "mutants.md").write_text(markdown(report(project, found, how)), encoding="utf-8")
    rows = [
        {**row, "module": m.module, "operator": m.mutation.operator, "diff": m.difference} for m, row in found
    ]
    write_json(given.out / "mutants.json", {"how": how, "tests": list(project.tests), "mutants": rows})
    _, noticed, survived, uncovered, same, score, interval = summary(rows)
    print(
        f"noticed {noticed} of {len(rows) - same} mutants ({score or 0:.2f}, 95 % interval {interval}); "
        f"survived {survived}, not covered {uncovered}, equivalent {same}: see {given.out / 'mutants.md'}"
    )
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
