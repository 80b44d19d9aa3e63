"""The layout as a test: who may import whom, what stays light, what is public, how long, how documented."""

from __future__ import annotations

import ast
import io
import re
import shutil
import statistics
import subprocess
import sys
import tokenize
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from textwrap import indent
from typing import NamedTuple

import pytest

import preshape

ROOT = Path(preshape.__file__).parent

LEVELS = (
    "exceptions types files processes spatial _version",
    "metrics objects report tasks",
    "hands kernels memory",
    "arm hiis viewer",
    "closure physics pictures",
    "planning planner",
    "dataset export",
    "app cli serve studies __init__ __main__",
)
"""Modules and packages directly below ``preshape``; a file imports from lower levels only."""
LEVEL = {unit: level for level, units in enumerate(LEVELS) for unit in units.split()}
BESIDE = {
    ("files", "exceptions"),
    ("processes", "exceptions"),
    ("spatial", "exceptions"),
    ("spatial", "types"),
    ("types", "exceptions"),
    ("planner", "planning"),
    ("cli", "app"),
    ("cli", "serve"),
    ("serve", "app"),
    ("cli", "studies"),
    ("__main__", "cli"),
}
"""The only imports between siblings of a level: (importer, imported)."""
HIIS = (
    "estimator fuzzy lbfgs planes",
    "analyser training wrench",
    "critic virtual_grasp",
    "decision learning",
    "lessons",
    "knowledge",
    "controller",
)
"""The levels within ``hiis``; no file imports one of its own level."""
STAGES = ("hiis.estimator", "hiis.critic", "hiis.virtual_grasp", "closure", "planning.hand_simulation")
"""Stages of the pipeline: a module, or a package with all its files."""
DRAWING = {"viewer", "pictures", "cli", "studies", "app"}
LIGHT = {"exceptions", "types", "spatial", "tasks", "_version", "__init__", "__main__"} | {
    "hiis",
    "hiis.fuzzy",
    "hiis.planes",
    "hiis.wrench",
}
"""What ``import preshape`` and the command line's --help load whole."""
LATE_SCIPY = {"spatial"}
"""Of these, what imports SciPy within its functions."""
HEAVY = (
    "scipy", "mujoco", "matplotlib", "trimesh", "fcl", "embreex", "manifold3d", "warp", "coacd", "viser",
    "pyarrow", "ray", "skimage",
)  # fmt: skip

MODULES = sorted(ROOT.rglob("*.py"))


Statement = tuple[ast.AST, bool, bool]


class Import(NamedTuple):
    """One import within the package: dotted module names below ``preshape``, as ``objects.mesh``."""

    source: str
    target: str
    typing: bool  # under ``if TYPE_CHECKING``
    late: bool  # within a function

    def __str__(self) -> str:
        return f"{self.source} imports {self.target}"


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def name_of(path: Path, root: Path) -> str:
    """The dotted name of a file; a package's ``__init__`` has the package's name, the root's its own."""
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)


def unit_of(name: str) -> str:
    """The top-level module or package that a module belongs to."""
    return name.split(".")[0]


def level_of(name: str) -> int:
    unit = unit_of(name)
    assert unit in LEVEL, f"{unit} has no level: give it one in LEVELS"
    return LEVEL[unit]


def statements(body: Iterable[ast.AST], *, typing: bool = False, late: bool = False) -> Iterator[Statement]:
    """Every statement, whether it is under ``if TYPE_CHECKING:`` and whether it runs in a called function."""
    for node in body:
        yield node, typing, late
        guarded = typing or (isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"))
        called = late or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        for part in ("body", "handlers", "cases"):
            yield from statements(getattr(node, part, ()), typing=guarded, late=called)
        for part in ("orelse", "finalbody"):
            yield from statements(getattr(node, part, ()), typing=typing, late=called)


def targets_of(node: ast.AST, folder: tuple[str, ...], modules: set[str]) -> Iterator[str]:
    """The modules within the package that a statement imports.

    Args:
        node: any statement.
        folder: the package of the file it stands in, as names below ``preshape``.
        modules: every module that exists.
    """
    if isinstance(node, ast.Import):
        for alias in node.names:
            first, *rest = alias.name.split(".")
            if first == "preshape":
                yield ".".join(rest) or "__init__"
    elif isinstance(node, ast.ImportFrom):
        parts = node.module.split(".") if node.module else []
        if node.level:
            assert node.level <= len(folder) + 1, f"{folder} imports from above the package"
            parts = [*folder[: len(folder) - node.level + 1], *parts]
        elif parts[:1] == ["preshape"]:
            parts = parts[1:]
        else:
            return
        for alias in node.names:
            inner = ".".join([*parts, alias.name])
            yield inner if inner in modules else ".".join(parts) or "__init__"


@cache
def imports_of(root: Path) -> tuple[Import, ...]:
    """Every import of every file, those within functions included."""
    files = {name_of(path, root): path for path in sorted(root.rglob("*.py"))}
    found, names = [], set(files)
    for source, path in files.items():
        folder = path.relative_to(root).parts[:-1]
        for node, typing, late in statements(tree_of(path).body):
            for target in targets_of(node, folder, names):
                found.append(Import(source, target, typing, late))
    return tuple(found)


def astray(root: Path) -> list[str]:
    """Imports of modules that do not exist."""
    there = {name_of(path, root) for path in root.rglob("*.py")}
    return [str(found) for found in imports_of(root) if found.target not in there]


def upward(root: Path) -> list[str]:
    """Imports of a higher level, file by file."""
    return [
        f"{found} (level {level_of(found.source)} to {level_of(found.target)})"
        for found in imports_of(root)
        if level_of(found.target) > level_of(found.source)
    ]


def sideways(root: Path) -> list[str]:
    """Imports between siblings of a level that are not listed."""
    pairs = ((found, unit_of(found.source), unit_of(found.target)) for found in imports_of(root))
    return [
        str(found)
        for found, importer, imported in pairs
        if importer != imported
        and level_of(importer) == level_of(imported)
        and (importer, imported) not in BESIDE
    ]


def circles(root: Path, *, of: Callable[[str], str] = str) -> list[str]:
    """What imports itself by way of others; imports for type checkers do not count.

    Args:
        root: the package.
        of: the group that a module belongs to; by default every file stands for itself.
    """
    edges = {(of(found.source), of(found.target)) for found in imports_of(root) if not found.typing}
    edges = {(source, target) for source, target in edges if source != target}
    while True:  # what nobody imports and what imports nothing is in no circle
        inner = {source for source, _ in edges} & {target for _, target in edges}
        left = {(source, target) for source, target in edges if source in inner and target in inner}
        if left == edges:
            return sorted(inner)
        edges = left


def room_of(name: str) -> str:
    """The sub-package of a module; a module directly within a package stands for itself."""
    parts = name.split(".")
    return ".".join(parts[:2]) if len(parts) > 2 else name


def stage_of(name: str) -> str | None:
    return next((stage for stage in STAGES if name == stage or name.startswith(f"{stage}.")), None)


def test_every_module_has_a_level() -> None:
    assert {unit_of(name_of(path, ROOT)) for path in MODULES} <= set(LEVEL)
    assert {name_of(path, ROOT).removeprefix("hiis.") for path in (ROOT / "hiis").glob("[!_]*.py")} == set(
        " ".join(HIIS).split()
    )
    assert len(MODULES) > 40


def test_the_reader_of_imports_sees_them() -> None:
    seen = imports_of(ROOT)
    assert {found.source for found in seen} > {
        "hiis.virtual_grasp",
        "kernels.rays",
        "viewer.page",
        "__init__",
    }
    assert Import("kernels.rays", "objects.mesh", typing=False, late=False) in seen
    assert (
        Import("viewer.page", "viewer.readings", typing=False, late=False) in seen
    )  # from . import readings
    assert Import("__init__", "hiis.controller", typing=True, late=False) in seen
    assert not [
        found
        for found in seen
        if found.source == "__init__" and not found.typing and found.target != "_version"
    ]
    assert any(found.late for found in seen if found.target == "studies")


def test_every_import_leads_to_a_module() -> None:
    assert not astray(ROOT)


def test_imports_go_downward() -> None:
    assert not upward(ROOT)


def test_siblings_of_a_level_import_each_other_only_as_listed() -> None:
    assert not sideways(ROOT)
    pairs = {(unit_of(found.source), unit_of(found.target)) for found in imports_of(ROOT)}
    there = {unit_of(name_of(path, ROOT)) for path in MODULES}
    assert {pair for pair in BESIDE if set(pair) <= there} <= pairs, "a listed pair that no file needs"


def test_no_circle_of_files_or_of_rooms() -> None:
    assert not circles(ROOT)
    assert not circles(ROOT, of=room_of)


def test_within_hiis_imports_go_downward() -> None:
    level = {f"hiis.{name}": level for level, names in enumerate(HIIS) for name in names.split()}
    inside = [f for f in imports_of(ROOT) if f.source in level and f.target in level]
    assert inside
    assert not [str(found) for found in inside if level[found.target] >= level[found.source]]


def test_no_stage_imports_another_stage() -> None:
    crossing = [
        str(found)
        for found in imports_of(ROOT)
        if stage_of(found.source) and stage_of(found.target) not in (None, stage_of(found.source))
    ]
    assert not crossing


def test_the_stages_are_there() -> None:
    names = {name_of(path, ROOT) for path in MODULES}
    assert {stage_of(name) for name in names} == {*STAGES, None}


def test_the_studies_are_imported_late_and_by_the_command_line_only() -> None:
    users = [f for f in imports_of(ROOT) if unit_of(f.target) == "studies" and unit_of(f.source) != "studies"]
    assert users
    assert not [str(f) for f in users if unit_of(f.source) != "cli" or not (f.late or f.typing)]


def test_only_what_draws_imports_the_viewer() -> None:
    """Its words about a plan are text, which the planner and the exports use too."""
    drawing = [f for f in imports_of(ROOT) if unit_of(f.target) == "viewer" and f.target != "viewer.words"]
    assert {unit_of(f.source) for f in drawing} <= DRAWING
    inside = {f.target for f in imports_of(ROOT) if f.source == "viewer.words"}
    assert inside == {"objects.mass", "tasks.task", "types"}


def test_the_viewer_knows_values_objects_tasks_hands_and_report_styles_only() -> None:
    known = {unit_of(f.target) for f in imports_of(ROOT) if unit_of(f.source) == "viewer"} - {"viewer"}
    assert known
    assert known <= {"exceptions", "files", "types", "objects", "tasks", "hands", "report"}


# The checks themselves: each sees the fault it is for, in whatever file it stands.

WHOLE = {
    "closure/grip.py": "from ..objects.mesh import TriangleMesh",
    "closure/pinching.py": "from .grip import Grip",
    "closure/search.py": "from .pinching import pinch\nfrom preshape.hands import Hand",
    "hands/__init__.py": "from .hand import Hand",
    "hands/hand.py": "from ..objects import mesh",
    "metrics/hull.py": "import numpy",
    "objects/mesh.py": "from __future__ import annotations",
    "objects/scans/surface.py": "from ..mesh import TriangleMesh",
    "physics/hold/runner.py": "from ..scene import Scene",
    "physics/scene.py": "import mujoco",
    "physics/task/runner.py": "from ..hold.runner import run",
    "planning/session.py": "from ..closure.search import search",
}
"""A package whose imports are as they should be: file and content."""


def package(folder: Path, **changed: str) -> Path:
    """``WHOLE`` as files, with lines added to some of them."""
    for file in WHOLE:
        for place in [folder / file, *((folder / p / "__init__.py") for p in Path(file).parents)]:
            place.parent.mkdir(parents=True, exist_ok=True)
            place.touch()
    for file, text in WHOLE.items():
        (folder / file).write_text(f"{text}\n")
    for file, line in changed.items():
        with (folder / file).open("a") as added:
            added.write(f"\n\n{line}\n")
    return folder


def late(statement: str) -> str:
    return f"def _late() -> None:\n    {statement}"


def test_the_whole_package_passes(tmp_path: Path) -> None:
    whole = package(tmp_path)
    assert upward(whole) == sideways(whole) == circles(whole) == circles(whole, of=room_of) == []
    assert astray(whole) == []
    assert len(imports_of(whole)) == 10


@pytest.mark.parametrize("file", ["closure/grip.py", "closure/pinching.py", "closure/search.py"])
@pytest.mark.parametrize("write", [str, late])
def test_an_upward_import_is_seen_in_every_file(
    tmp_path: Path, file: str, write: Callable[[str], str]
) -> None:
    broken = package(tmp_path, **{file: write("from ..planning.session import Session")})
    name = file.removesuffix(".py").replace("/", ".")
    assert upward(broken) == [f"{name} imports planning.session (level 4 to 5)"]


@pytest.mark.parametrize(
    ("statement", "told"),
    [
        ("from ...metrics import hull", "metrics.hull"),
        ("from ...metrics.hull import area", "metrics.hull"),
        ("import preshape.metrics", "metrics"),
        ("from preshape import metrics", "metrics"),
    ],
)
def test_a_sibling_import_is_seen(tmp_path: Path, statement: str, told: str) -> None:
    broken = package(tmp_path, **{"objects/scans/surface.py": late(statement)})
    assert sideways(broken) == [f"objects.scans.surface imports {told}"]


def test_a_circle_within_a_package_is_seen_through_functions(tmp_path: Path) -> None:
    broken = package(tmp_path, **{"closure/grip.py": late("from .search import search")})
    assert circles(broken) == ["closure.grip", "closure.pinching", "closure.search"]
    assert upward(broken) == sideways(broken) == []


def test_imports_for_type_checkers_make_no_circle(tmp_path: Path) -> None:
    line = "from typing import TYPE_CHECKING\n\nif TYPE_CHECKING:\n    from .search import search"
    assert circles(package(tmp_path, **{"closure/grip.py": line})) == []


def test_a_circle_of_rooms_is_seen(tmp_path: Path) -> None:
    (tmp_path / "physics" / "task").mkdir(parents=True)
    (tmp_path / "physics" / "task" / "tables.py").touch()
    broken = package(tmp_path, **{"physics/hold/runner.py": late("from ..task.tables import rows")})
    assert circles(broken) == []
    assert circles(broken, of=room_of) == ["physics.hold", "physics.task"]


def test_an_import_of_what_does_not_exist_is_seen(tmp_path: Path) -> None:
    broken = package(tmp_path, **{"closure/grip.py": late("from ..planning.output import write")})
    assert astray(broken) == ["closure.grip imports planning.output"]


def test_the_document_draws_the_same_levels() -> None:
    text = (ROOT.parents[1] / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d) \| ((?:`[^`]+` ?)+)\|", text, flags=re.MULTILINE)
    drawn = {int(level): set(names.replace("`", "").split()) for level, names in rows}
    there = {unit_of(name_of(path, ROOT)) for path in MODULES}
    for level, units in enumerate(LEVELS):
        assert drawn.pop(level) == set(units.split()) & there, f"level {level} of docs/architecture.md"
    assert not drawn


def test_nothing_heavy_is_imported_below_a_module_that_the_package_always_loads() -> None:
    light = {name: path for path in MODULES if (name := name_of(path, ROOT)) in LIGHT}
    assert set(light) == LIGHT
    heavy = []
    for module, path in light.items():
        for node, _, late in statements(tree_of(path).body):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            allowed = {"scipy"} if late and module in LATE_SCIPY else set()
            found = {name.split(".")[0] for name in names} & set(HEAVY) - allowed
            heavy += [f"{module} imports {name}" for name in found]
    assert not heavy


def loaded_after(code: str) -> set[str]:
    """Which heavy libraries a fresh interpreter has loaded after running ``code``."""
    report = f"\nimport sys\nprint('loaded', *[m for m in {HEAVY!r} if m in sys.modules])"
    ran = subprocess.run([sys.executable, "-c", code + report], capture_output=True, text=True, check=True)
    return set(ran.stdout.strip().splitlines()[-1].split()[1:])


@pytest.mark.parametrize(
    "code",
    [
        "import preshape; preshape.__version__; dir(preshape)",
        "import preshape.cli.main",
        "import preshape.objects, preshape.hands, preshape.kernels, preshape.tasks, preshape.hiis.fuzzy",
        "from preshape import Task, parse_task, FuzzySets, tfvadi, Hand, load_object, TriangleMesh, Memory",
        "import preshape; preshape.load_hand('utah_mit')",
        "import sys; from preshape.cli.main import main; sys.argv = ['preshape', '--help']\n"
        "try:\n    main()\nexcept SystemExit as end:\n    assert not end.code, end.code",
        "import sys; from preshape.cli.main import main; sys.argv = ['preshape', 'plan', '--help']\n"
        "try:\n    main()\nexcept SystemExit as end:\n    assert not end.code, end.code",
    ],
    ids=["package", "cli", "subpackages", "names", "hand", "help", "plan --help"],
)
def test_importing_loads_nothing_heavy(code: str) -> None:
    assert loaded_after(code) == set()


@pytest.mark.usefixtures("session_cache")
def test_a_recalled_answer_loads_no_scipy(lesson: Callable[[str], Path], tmp_path: Path) -> None:
    """SciPy alone would take half as long to import as the whole plan of a known object takes."""
    memory = str(shutil.copy(lesson("shadow"), tmp_path / "memory.sqlite"))
    plan = f"import preshape\nmade = preshape.plan('cube', 'lift', hand='shadow', memory={memory!r})\n"
    # Another process learns and settles, and writes the caches that this one may have elsewhere.
    loaded_after(f"mode = 1\nwhile mode:\n{indent(plan, '    ')}    mode = made.decision.mode")
    loaded = loaded_after(plan + "assert made.decision.mode == 0 and made.answer is not None")
    assert {"warp", "mujoco"} <= loaded <= {"warp", "mujoco", "manifold3d"}


def test_the_check_for_heavy_libraries_can_fail() -> None:
    assert loaded_after("import trimesh") >= {"trimesh"}


def test_public_names() -> None:
    assert len(preshape.__all__) == len(set(preshape.__all__)) <= 40
    assert list(preshape.__all__) == sorted(preshape.__all__)
    for name in preshape.__all__:
        assert getattr(preshape, name) is not None
        if name != "__version__":
            assert getattr(preshape, name).__module__.startswith("preshape.")
            assert getattr(preshape, name).__name__ == name
    assert dir(preshape) == sorted(preshape.__all__)
    with pytest.raises(AttributeError, match="has no attribute 'plann'"):
        _ = preshape.plann


def test_public_names_are_the_same_for_readers_type_checkers_and_at_run_time() -> None:
    for_checkers = {
        (a.asname or a.name): node.module
        for node, typing, _ in statements(tree_of(ROOT / "__init__.py").body)
        if typing and isinstance(node, ast.ImportFrom)
        for a in node.names
    }
    assert for_checkers == preshape._HOME
    assert set(preshape.__all__) == {*preshape._HOME, "__version__"}


def test_star_import_gives_exactly_the_public_names() -> None:
    space: dict[str, object] = {}
    exec("from preshape import *", space)  # noqa: S102
    assert set(space) - {"__builtins__"} == set(preshape.__all__)


def test_every_all_is_real() -> None:
    unreal, seen = [], 0
    for path in MODULES:
        listed = [
            ast.literal_eval(node.value)
            for node in tree_of(path).body
            if isinstance(node, ast.Assign)
            and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets)
        ]
        if listed and path != ROOT / "__init__.py":
            name = f"preshape.{name_of(path, ROOT)}"
            module = __import__(name, fromlist=["_"])
            unreal += [f"{name}.{entry}" for entry in listed[0] if not hasattr(module, entry)]
            seen += 1
    assert seen > 5
    assert not unreal


def test_every_class_has_a_name_of_its_own() -> None:
    every = [node for path in MODULES for node, _, _ in statements(tree_of(path).body)]
    names = [node.name for node in every if isinstance(node, ast.ClassDef)]
    assert len(names) > 100
    assert not {name for name in names if names.count(name) > 1}


def lines_of_code(path: Path) -> int:
    """Lines that hold code; docstrings, comments and blank lines do not count, so that nobody saves words."""
    text, documented = path.read_text(encoding="utf-8"), set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            for entry in node.body:
                if isinstance(entry, ast.Expr) and isinstance(entry.value, ast.Constant):
                    documented |= set(range(entry.lineno, (entry.end_lineno or entry.lineno) + 1))
    silent = (
        tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER,
    )  # fmt: skip
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in silent:
            code |= set(range(token.start[0], token.end[0] + 1))
    return len(code - documented)


def test_no_module_has_more_than_350_lines_of_code() -> None:
    long = [path for path in MODULES if len(path.read_text(encoding="utf-8").splitlines()) > 350]
    lengths = {name_of(path, ROOT): lines_of_code(path) for path in long}
    assert not {name: length for name, length in lengths.items() if length > 350}


def test_half_of_the_modules_are_short() -> None:
    lengths = [len(p.read_text(encoding="utf-8").splitlines()) for p in MODULES]
    assert statistics.median(lengths) <= 200


def test_every_public_thing_has_a_docstring() -> None:
    missing = [name_of(path, ROOT) for path in MODULES if not ast.get_docstring(tree_of(path))]

    def visit(body: list[ast.stmt], prefix: str) -> None:
        for node in body:
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                continue
            if node.name.startswith("_"):
                continue
            if not ast.get_docstring(node):
                missing.append(prefix + node.name)
            if isinstance(node, ast.ClassDef):
                visit(node.body, f"{prefix}{node.name}.")

    for path in MODULES:
        visit(tree_of(path).body, f"{name_of(path, ROOT)}.")
    assert not missing


def test_what_is_forbidden_everywhere() -> None:
    forbidden = []
    for path in MODULES:
        module = name_of(path, ROOT)
        if {unit_of(module), path.stem} & {"utils", "helpers", "common", "misc"}:
            forbidden.append(module)
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = {a.name.split(".")[0] for a in node.names} | {
                    (getattr(node, "module", "") or "").split(".")[0]
                }
                found = names & {"pickle", "marshal", "shelve", "dill", "joblib"}
                forbidden += [f"{module} imports {name}" for name in found]
            name = node.func.id if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) else ""
            if name in {"eval", "exec", "compile"}:
                forbidden.append(f"{module} calls {name}")
    assert not forbidden
