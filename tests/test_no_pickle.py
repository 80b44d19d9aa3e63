"""Nothing is ever pickled and no text is ever run: the whole package is read for it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import preshape

PACKAGE = Path(preshape.__file__).parent
SERIALISERS = {
    "pickle",
    "cPickle",
    "_pickle",
    "pickletools",
    "marshal",
    "shelve",
    "dill",
    "cloudpickle",
    "joblib",
}
RUNNERS = {"eval", "exec", "compile", "__import__"}


def offences(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name.partition(".")[0] for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [(node.module or "").partition(".")[0], *(alias.name for alias in node.names)]
        elif isinstance(node, ast.Name):
            names = [node.id]
        elif isinstance(node, ast.Attribute):
            runs = isinstance(node.value, ast.Name) and node.value.id in {"builtins", "__builtins__"}
            names = [node.attr] if runs or node.attr in SERIALISERS else []
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            names = [node.value] if node.value in SERIALISERS | {"eval", "exec"} else []
        elif isinstance(node, ast.keyword) and node.arg == "allow_pickle":
            refused = isinstance(node.value, ast.Constant) and node.value.value is False
            names = [] if refused else ["allow_pickle"]
        forbidden = SERIALISERS | RUNNERS | {"allow_pickle"}
        yield from (f"line {getattr(node, 'lineno', 0)}: {name}" for name in names if name in forbidden)


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "import os, pickle as p",
        "from pickle import loads",
        "from multiprocessing.reduction import pickle",
        "import importlib; importlib.import_module('pickle')",
        "__import__('pick' + 'le')",
        "eval('1')",
        "f = exec",
        "import builtins; builtins.eval('1')",
        "np.load(f, allow_pickle=True)",
        "np.load(f, allow_pickle=flag)",
        "pandas.compat.pickle.load(f)",
    ],
)
def test_the_reader_sees(source: str) -> None:
    assert list(offences(source))


@pytest.mark.parametrize(
    "source", ["re.compile('a')", "np.load(f, allow_pickle=False)", "'''Never pickled.'''", "model.eval()"]
)
def test_the_reader_lets_pass(source: str) -> None:
    assert not list(offences(source))


def test_the_package_never_pickles_and_never_runs_text() -> None:
    files = sorted(PACKAGE.rglob("*.py"))
    assert PACKAGE / "memory" / "store.py" in files
    found = [f"{file.name} {what}" for file in files for what in offences(file.read_text(encoding="utf-8"))]
    assert not found
