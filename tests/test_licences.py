"""The list of licences is what the installed packages say, whole, and free."""

from __future__ import annotations

import pytest

licences = pytest.importorskip("hardening.licences", reason="the folder hardening is not here")

PAGE = licences.PAGE.read_text(encoding="utf-8")
LISTED = {
    cells[0]: cells[1:]
    for line in PAGE.split(licences.BEGIN)[1].split(licences.END)[0].splitlines()
    if line.startswith("| ") and len(cells := [cell.strip() for cell in line.strip("|").split("|")]) == 3
    if cells[0] != "package"
}


def test_every_direct_dependency_is_listed_and_no_other() -> None:
    assert {name: where for name, (where, _) in LISTED.items()} == licences.direct(), (
        "run: python -m hardening.licences"
    )


@pytest.mark.parametrize("name", sorted(LISTED))
def test_the_licence_is_what_the_package_states(name: str) -> None:
    stated = licences.stated(name)
    if stated is None:
        pytest.skip(f"{name} is not installed")
    assert LISTED[name][1] == stated, "run: python -m hardening.licences"


@pytest.mark.parametrize("name", sorted(LISTED))
def test_every_licence_is_free(name: str) -> None:
    assert any(word.lower() in LISTED[name][1].lower() for word in licences.FREE)


def test_what_always_runs_is_explained_above() -> None:
    above = PAGE.split(licences.BEGIN)[0]
    table = " ".join(line.split("|")[1] for line in above.splitlines() if line.startswith("| "))
    told = {word.strip(",") for word in table.split()}
    missing = {name for name, where in licences.direct().items() if where == "run"} - told
    assert not missing
