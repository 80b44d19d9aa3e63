"""Licences of the dependencies, as the installed packages state them.

``python -m hardening.licences`` updates the table in ``docs/dependencies.md``; a test compares it.
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

FREE = (
    "Apache", "BSD", "MIT", "ISC", "PSF", "MPL", "Python Software Foundation", "HPND", "matplotlib", "TOST",
)  # fmt: skip
"""Words of licences that allow use and distribution as part of a program under Apache-2.0; TOST-1.0 is
Apache-2.0 with another section on trademarks."""


_TEXTS = {
    "BSD": "Redistribution and use in source and binary forms",
    "MIT": "Permission is hereby granted, free of charge",
    "Apache-2.0": "Apache License",
}
"""Words from the texts of licences, for packages that give only the text of their licence."""

_SILENT = {"atheris": "Apache-2.0"}
"""Licences of packages that state none, taken from their source."""


def direct() -> dict[str, str]:
    """Every direct dependency in ``pyproject.toml``, with ``run`` or the name of its extra."""
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
    """The licence that an installed package states; ``None`` where the package is not installed."""
    try:
        fields = metadata(name)
    except PackageNotFoundError:
        return None
    if fields["License-Expression"]:
        return str(fields["License-Expression"]).strip()
    classes = [
        line.rpartition(" :: ")[2].removesuffix(" License")
        for line in fields.get_all("Classifier") or []
        if line.startswith("License :: ") and line != "License :: OSI Approved"
    ]
    text = " ".join(str(fields["License"] or "").split())
    known = next((name for name, words in _TEXTS.items() if words in text), None)
    if classes:
        return ", ".join(classes)
    return text if text and len(text) <= 40 else known or _SILENT.get(name, "not stated")


def rows() -> list[str]:
    """One row of the table for every direct dependency, sorted; a missing package keeps its old row."""
    old = dict(re.findall(r"^\| (\S+) \| [^|]* \| ([^|]*) \|$", PAGE.read_text(encoding="utf-8"), re.M))
    return [
        f"| {name} | {where} | {stated(name) or old.get(name, 'not installed').strip()} |"
        for name, where in sorted(direct().items())
    ]


def main() -> int:
    """Update the table."""
    page = PAGE.read_text(encoding="utf-8")
    table = "\n".join([BEGIN, "", "| package | for | licence |", "|---|---|---|", *rows(), "", END])
    head, rest = page.split(BEGIN)
    PAGE.write_text(head + table + rest.split(END)[1], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
