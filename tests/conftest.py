from __future__ import annotations

import hashlib
import os
import pickle
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from preshape.files import locked


@pytest.fixture(scope="session")
def reference() -> Path:
    """The folder of reference data; a test that needs it is left out, and counted, where it is missing."""
    folder = os.environ.get("PRESHAPE_REFERENCE", "")
    if not folder or not Path(folder).is_dir():
        pytest.skip("PRESHAPE_REFERENCE is not set")
    return Path(folder)


def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The temporary folder that all workers of this test run have in common."""
    folder = tmp_path_factory.getbasetemp()
    return folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], object]], Path]:
    """Makes a file that takes long for all workers together: the first that asks makes it, others wait.

    The file is for reading; who wants to change it takes a copy.
    """
    folder = shared_folder(tmp_path_factory)

    def made(name: str, make: Callable[[Path], object]) -> Path:
        file, part = folder / f"once-{name}", folder / f"once-part-{name}"
        with (folder / f"once-{name}.lock").open("ab") as lock:
            while not locked(lock):
                time.sleep(0.02)
            if not file.exists():
                make(part)
                part.rename(file)
        return file

    return made


@pytest.fixture(scope="module")
def session_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A module's cache is this test run's, for all workers and modules that ask, and not the user's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PRESHAPE_CACHE", str(shared_folder(tmp_path_factory) / "cache"))
        yield


@pytest.fixture(scope="module")
def small_pictures() -> Iterator[None]:
    """A module draws the pictures of plans with a quarter of the pixels, which take seconds otherwise."""
    from preshape.viewer.plan_picture import plan_picture

    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(plan_picture.__kwdefaults__, "size", (700, 450))
        yield


@pytest.fixture(scope="session")
def lesson(once: Callable[[str, Callable[[Path], object]], Path]) -> Callable[[str], Path]:
    """The memory of a hand that knows its first lesson, the cube, and nothing else, as a file.

    It is what a controller makes of an empty memory; ``test_plan_closure`` begins with an empty one.
    """
    from preshape.closure.settings import ClosureSettings
    from preshape.hands import load_hand
    from preshape.hiis.decision import Settings
    from preshape.memory import Memory
    from preshape.planning.controllers import closure_controller
    from preshape.tasks import parse_task

    def taught(name: str) -> Path:
        def make(path: Path) -> None:
            hand = load_hand(name)
            with Memory.open(path) as memory:
                closure_controller(
                    memory,
                    hand,
                    settings=Settings(),
                    closure=ClosureSettings(),
                    gravity=parse_task("lift").gravity,
                )

        return once(f"{name}.sqlite", make)

    return taught


@pytest.fixture(scope="session", autouse=True)
def first_lessons(once: Callable[[str, Callable[[Path], object]], Path]) -> Iterator[None]:
    """All workers make the first lesson of a real hand once, and not for every memory that begins empty.

    The lesson takes seconds and depends on the hand and the settings alone: ``test_plan_closure`` makes one
    again and compares.
    """
    from preshape.closure.analyser import ClosureAnalyser
    from preshape.closure.hand_tables import digest
    from preshape.hiis import knowledge

    make, made = knowledge.seed_experiences, dict[str, Any]()

    def shared(analyser: Any, sets: Any, **more: Any) -> Any:
        if not isinstance(analyser, ClosureAnalyser):
            return make(analyser, sets, **more)
        told = [analyser.settings, analyser.coefficients, analyser.sets, analyser.gravity, analyser.seed]
        content = pickle.dumps((digest(analyser.hand, ""), analyser.layout, *told, sets, more))
        key = hashlib.sha256(content).hexdigest()[:32]
        if key not in made:
            lesson = partial(make, analyser, sets, **more)
            file = once(f"{key}.lesson", lambda path: path.write_bytes(pickle.dumps(lesson())))
            made[key] = pickle.loads(file.read_bytes())  # noqa: S301  (this test run has written it)
        return list(made[key])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(knowledge, "seed_experiences", shared)
        yield


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The browser's tests first: they are the slowest, and no worker is to wait for another's at the end."""
    items.sort(key=lambda item: not item.path.name.startswith("test_view_app"))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    skipped = [str(report.longrepr) for report in terminalreporter.stats.get("skipped", [])]
    for reason, what in {
        "PRESHAPE_REFERENCE is not set": "checks against reference data were left out: "
        "set PRESHAPE_REFERENCE to the folder with them",
        "there is no scan of the paper": "checks against the paper's text were left out: "
        "put paper.txt beside the folder PRESHAPE_REFERENCE",
        "one kernel of BLAS and NumPy": "checks that weights do not depend on the kernels were left out: "
        "this machine has only one",
    }.items():
        count = sum(reason in text for text in skipped)
        if count:
            terminalreporter.write_line(f"{count} {what}")
