"""The installed versions: constraints.txt names them, constraints-hashed.txt has the hash of every file."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent
PINNED = re.compile(r"([A-Za-z0-9._-]+)==([^\s;]+)(?: ; [^\\]+)?")


def plain(name: str) -> str:
    """A package's name as the index knows it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def pins(file: str) -> dict[str, str]:
    """Version of each package in a file; a line that is no pin is a fault."""
    text = (ROOT / file).read_text().replace("\\\n", "")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    found = [PINNED.match(line) for line in lines]
    assert all(found), [line for line, match in zip(lines, found, strict=True) if not match]
    assert len({plain(match[1]) for match in found if match}) == len(lines)
    return {plain(match[1]): match[2] for match in found if match}


def test_every_hashed_version_is_the_one_of_the_constraints() -> None:
    versions, hashed = pins("constraints.txt"), pins("constraints-hashed.txt")
    assert hashed.items() <= versions.items()
    assert len(hashed) > 70


def test_every_package_has_hashes_and_no_place_is_named() -> None:
    text = (ROOT / "constraints-hashed.txt").read_text()
    entries = re.split(r"\n(?=[A-Za-z])", re.sub(r"^#.*\n", "", text, flags=re.M).strip())
    assert len(entries) == len(pins("constraints-hashed.txt"))
    for entry in entries:
        first, *hashes = [line.strip().removesuffix("\\").strip() for line in entry.splitlines()]
        assert hashes, first
        assert all(re.fullmatch("--hash=sha256:[0-9a-f]{64}", one) for one in hashes), first
    for file in ("constraints.txt", "constraints-hashed.txt"):
        assert not re.search(r"://|^-|--index|--find-links", (ROOT / file).read_text(), flags=re.M)


def test_whatever_the_package_its_tests_and_its_documents_need_is_hashed() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    needed = [*project["dependencies"], *extras["dev"], *extras["docs"]]
    names = {plain(re.split(r"[<>=!~\[; ]", requirement)[0]) for requirement in needed}
    assert names <= pins("constraints-hashed.txt").keys()
