"""The licences of what preshape needs, as the installed packages state them.

``python -m hardening.licences`` writes the table in ``docs/dependencies.md`` again; a test compares it.
"""

from __future__ import annotations

import re
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "dependencies.md"
BEGIN, END = "<!-- licences: python -m hardening.licences -->", "<!-- end of licences -->"

FREE = ("Apache", "BSD", "MIT", "ISC", "PSF", "MPL", "Python Software Foundation", "HPND", "matplotlib")
"""Words of licences under which a program may be used and given on, as part of a whole under Apache-2.0."""


_TEXTS = {
    "BSD": "Redistribution and use in source and binary forms",
    "MIT": "Permission is hereby granted, free of charge",
    "Apache-2.0": "Apache License",
}
"""What the texts of licences say, for packages that state their licence by its text alone."""

_SILENT = {"atheris": "Apache-2.0"}
"""The licences of packages that state none, as their source has them."""


def direct() -> dict[str, str]:
    """Every package that ``pyproject.toml`` asks for itself, and where: ``run`` or the name of an extra."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = {"run": project["dependencies"], **project["optional-dependencies"]}
    found: dict[str, str] = {}
    for where, requirements in asked.items():
        for requirement in requirements:
            name = re.split(r"[^A-Za-z0-9_.-]", requirement, maxsplit=1)[0].lower()
            if name != project["name"]:
                found.setdefault(name, where)
    return found


def stated(name: str) -> str | None:
    """The licence that an installed package states; ``None`` where it is not installed."""
    try:
        said = metadata(name)
    except PackageNotFoundError:
        return None
    if said["License-Expression"]:
        return str(said["License-Expression"]).strip()
    classes = [
        line.rpartition(" :: ")[2].removesuffix(" License")
        for line in said.get_all("Classifier") or []
        if line.startswith("License :: ") and line != "License :: OSI Approved"
    ]
    text = " ".join(str(said["License"] or "").split())
    known = next((name for name, words in _TEXTS.items() if words in text), None)
    if classes:
        return ", ".join(classes)
    return text if text and len(text) <= 40 else known or _SILENT.get(name, "not stated")


def rows() -> list[str]:
    """One row of the table for every direct dependency, sorted; of one that is not installed the old row."""
    old = dict(re.findall(r"^\| (\S+) \| [^|]* \| ([^|]*) \|$", PAGE.read_text(encoding="utf-8"), re.M))
    return [
        f"| {name} | {where} | {stated(name) or old.get(name, 'not installed').strip()} |"
        for name, where in sorted(direct().items())
    ]


def main() -> int:
    """Write the table."""
    page = PAGE.read_text(encoding="utf-8")
    table = "\n".join([BEGIN, "", "| package | for | licence |", "|---|---|---|", *rows(), "", END])
    if BEGIN in page:
        head, rest = page.split(BEGIN)
        page = head + table + rest.split(END)[1]
    else:
        page = f"{page.rstrip()}\n\n{TITLE}\n\n{table}\n"
    PAGE.write_text(page, encoding="utf-8")
    return 0


TITLE = """## Licences

What preshape asks for itself, with the licence that each package states of itself (`run`: always installed;
else the extra that asks for it). None of their code is in the repository. This table is written by
`python -m hardening.licences` and compared with the installed packages by `tests/test_licences.py`."""


if __name__ == "__main__":
    sys.exit(main())
