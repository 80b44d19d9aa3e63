"""The API pages name what exists, each thing once, and every root name; ``make docs`` builds them."""

from __future__ import annotations

import importlib
import inspect
import re
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import preshape

FOLDER = Path(__file__).parent.parent / "docs" / "api"
PAGES = sorted(FOLDER.glob("*.rst"))
DIRECTIVE = re.compile(r"^\.\. (auto\w+|literalinclude):: (\S+)\n((?:   :.*\n)*)", re.MULTILINE)
EXAMPLE = Path(__file__).parent.parent / "examples" / "07_api.py"


class Directive(NamedTuple):
    """One directive of a page."""

    page: Path
    kind: str
    target: str
    options: dict[str, str]


@cache
def directives() -> tuple[Directive, ...]:
    found = []
    for page in PAGES:
        for kind, target, rest in DIRECTIVE.findall(page.read_text(encoding="utf-8") + "\n"):
            options = dict(re.findall(r":([\w-]+): ?(.*)", rest))
            found.append(Directive(page, kind, target, options))
    return tuple(found)


def documented() -> list[Directive]:
    return [each for each in directives() if each.kind != "literalinclude"]


@cache
def resolved(dotted: str) -> Any:
    """The object of a dotted name: the longest module, then its attributes."""
    parts = dotted.split(".")
    for count in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError as error:
            if not ".".join(parts[:count]).startswith(str(error.name)):
                raise
            continue
        for part in parts[count:]:
            thing = getattr(thing, part)
        return thing
    raise AssertionError(f"nothing of {dotted} can be imported")


def members(module: Any, options: dict[str, str]) -> list[Any]:
    """Classes and functions of a module that autodoc would show."""
    if "no-members" in options:
        return []
    names = (
        module.__all__
        if "imported-members" in options
        else [n for n in vars(module) if not n.startswith("_")]
    )
    left_out = options.get("exclude-members", "").replace(",", " ").split()
    things = [getattr(module, name) for name in names if name not in left_out]
    things = [thing for thing in things if inspect.isclass(thing) or inspect.isfunction(thing)]
    if "imported-members" not in options:
        things = [thing for thing in things if thing.__module__ == module.__name__]
    return [thing for thing in things if thing.__doc__]


def shown() -> list[Any]:
    """Every class and function of the pages, as often as it is there."""
    found = []
    for each in documented():
        thing = resolved(each.target)
        if each.kind == "automodule":
            found += members(thing, each.options)
        elif each.kind != "autodata":
            found.append(thing)
    return found


def test_the_reader_of_pages_sees_them():
    assert len(PAGES) >= 10
    assert len(documented()) > 100
    kinds = {each.kind for each in documented()}
    assert kinds == {"automodule", "autoclass", "autofunction", "autoexception", "autodata"}
    in_text = sum(page.read_text().count("\n.. auto") for page in PAGES)
    assert in_text == len(documented())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_a_page_names_exists_and_is_what_it_says(page):
    fits = {
        "automodule": inspect.ismodule,
        "autoclass": lambda thing: inspect.isclass(thing) and not issubclass(thing, BaseException),
        "autofunction": inspect.isfunction,
        "autoexception": lambda thing: inspect.isclass(thing) and issubclass(thing, BaseException),
        "autodata": lambda thing: (
            hasattr(thing, "__origin__")
            or not (inspect.isclass(thing) or inspect.isroutine(thing) or inspect.ismodule(thing))
        ),
    }
    for each in documented():
        if each.page == page:
            thing = resolved(each.target)
            assert fits[each.kind](thing), f"{each.target} is no {each.kind.removeprefix('auto')}"
            assert each.kind == "autodata" or inspect.getdoc(thing), f"{each.target} says nothing"
            for name in each.options.get("exclude-members", "").replace(",", " ").split():
                assert hasattr(thing, name), f"{each.target} has no {name} to leave out"


def test_every_root_name_is_documented_as_a_root_name():
    targets = {each.target for each in documented()}
    assert {f"preshape.{name}" for name in preshape.__all__} <= targets


def test_nothing_is_documented_twice():
    names = [f"{thing.__module__}.{thing.__qualname__}" for thing in shown()]
    assert sorted({name for name in names if names.count(name) > 1}) == []
    assert {"preshape.planner.plan", "preshape.metrics.hull.epsilon", "preshape.spatial.Screw"} <= set(names)


def test_no_property_begins_with_what_reads_as_its_type():
    # Napoleon takes the words before a colon in a property's first line for its type, without a warning.
    classes = {thing for thing in shown() if inspect.isclass(thing)}
    assert len(classes) > 50
    for cls in classes:
        for name, thing in vars(cls).items():
            if isinstance(thing, property) and thing.__doc__:
                first = re.sub(r"(:\w+:)?`+[^`]+`+", "", thing.__doc__.splitlines()[0])
                assert ": " not in first, (
                    f"{cls.__module__}.{cls.__name__}.{name}: no colon in the first line"
                )


def test_every_error_is_on_the_page_of_errors():
    exceptions = importlib.import_module("preshape.exceptions")
    errors = {thing for thing in vars(exceptions).values() if inspect.isclass(thing)}
    errors = {thing for thing in errors if issubclass(thing, exceptions.PreshapeError)}
    assert {resolved(each.target) for each in documented() if each.kind == "autoexception"} == errors


def test_every_page_is_listed_and_every_link_leads_to_a_page():
    index = (FOLDER / "index.rst").read_text(encoding="utf-8")
    listed = re.findall(r"^   (\w+)$", index.split(".. toctree::")[1], re.MULTILINE)
    assert sorted(listed) == [page.stem for page in PAGES if page.stem != "index"]
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert set(re.findall(r":doc:`(\w+)`", text)) <= {other.stem for other in PAGES}
        assert "://" not in text
        for name in re.findall(r":(?:func|meth|class):`([\w.]+)`", text):
            resolved(name)


def test_what_the_pages_show_of_the_example_is_there():
    parts = [each for each in directives() if each.kind == "literalinclude"]
    assert len(parts) >= 3
    for each in parts:
        assert (each.page.parent / each.target).resolve() == EXAMPLE
        text = EXAMPLE.read_text(encoding="utf-8")
        for option, marker in each.options.items():
            if option != "language":
                assert marker in text, f"{each.page.name}: {marker!r} is not in {EXAMPLE.name}"


def test_from_mesh_to_grasp_in_ten_lines():
    text = EXAMPLE.read_text(encoding="utf-8")
    part = text.split("# From mesh to grasp\n")[1].split("# To other programs\n")[0]
    lines = [line for line in part.splitlines() if line.strip()]
    assert len(lines) == 10
    assert "load_object(" in lines[0]
    assert "posture.q" in lines[-1]
