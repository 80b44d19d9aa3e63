from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def reference() -> Path:
    """The folder of reference data; a test that needs it is left out, and counted, where it is missing."""
    folder = os.environ.get("PRESHAPE_REFERENCE", "")
    if not folder or not Path(folder).is_dir():
        pytest.skip("PRESHAPE_REFERENCE is not set")
    return Path(folder)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The browser's tests first: they are the slowest, and no worker is to wait for another's at the end."""
    items.sort(key=lambda item: not item.path.name.startswith("test_view_app"))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    skipped = terminalreporter.stats.get("skipped", [])
    reason = "PRESHAPE_REFERENCE is not set"
    count = sum(reason in str(report.longrepr) for report in skipped)
    if count:
        terminalreporter.write_line(
            f"{count} checks against reference data were left out: "
            "set PRESHAPE_REFERENCE to the folder with them"
        )
