"""The layout as a test: who may import whom, what stays light, what is public, how long, how documented."""

from __future__ import annotations

import ast
import statistics
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import preshape

ROOT = Path(preshape.__file__).parent

LEVELS = {
    0: "exceptions spatial types fuzzy files _version",
    1: "clouds objects tasks planes wrench kernels hands metrics",
    2: "analyser estimator training virtual_grasp hand_simulation critic closure",
    3: "memory learning decision controller closure_control",
    4: "planner physics experiments dataset io pictures viewer cli export app __init__ __main__",
}
LEVEL = {unit: level for level, units in LEVELS.items() for unit in units.split()}
ALLOWED_BESIDE = {("kernels", "objects"), ("hands", "objects"), ("objects", "clouds")}  # on level 1
STAGES = {"virtual_grasp", "closure", "estimator", "critic", "hand_simulation"}
DRAWING = {"viewer", "pictures", "cli", "experiments", "app"}
HEAVY = (
    "scipy", "mujoco", "matplotlib", "trimesh", "fcl", "embreex", "manifold3d", "warp", "coacd", "viser",
    "pyarrow", "ray", "skimage",
)  # fmt: skip

MODULES = sorted(ROOT.rglob("*.py"))
every_module = pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))


def unit_of(path: Path) -> str:
    """The top-level module or package that a file belongs to."""
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def for_typing_only(tree: ast.Module) -> set[ast.AST]:
    """Nodes under ``if TYPE_CHECKING:``."""
    guarded = [
        n for n in ast.walk(tree) if isinstance(n, ast.If) and ast.unparse(n.test).endswith("TYPE_CHECKING")
    ]
    return {inner for n in guarded for body in n.body for inner in ast.walk(body)}


def imports_of(path: Path, *, typing: bool = True) -> set[str]:
    """Dotted names within the package that a file imports anywhere, functions included (``objects.mesh``)."""
    tree = tree_of(path)
    skipped = set() if typing else for_typing_only(tree)
    package = path.relative_to(ROOT).parts[:-1]
    found = set()
    for node in ast.walk(tree):
        if node in skipped:
            continue
        if isinstance(node, ast.Import):
            found |= {
                a.name.removeprefix("preshape").lstrip(".") or "__init__"
                for a in node.names
                if a.name.split(".")[0] == "preshape"
            }
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                base = list(package[: len(package) - node.level + 1])
                assert node.level <= len(package) + 1, f"{path}: imports from above the package"
            elif (node.module or "").split(".")[0] == "preshape":
                base = []
            else:
                continue
            module = node.module or ""
            base += (
                module.removeprefix("preshape").strip(".").split(".") if not node.level else module.split(".")
            )
            dotted = ".".join(part for part in base if part)
            if dotted:
                found.add(dotted)
            else:  # from . import x, from preshape import x
                found |= {a.name if a.name in LEVEL else "__init__" for a in node.names}
    return found


def units_imported(path: Path, *, typing: bool = True) -> set[str]:
    return {name.split(".")[0] for name in imports_of(path, typing=typing)} - {unit_of(path)}


def test_every_module_has_a_level() -> None:
    assert {unit_of(path) for path in MODULES} <= set(LEVEL)
    assert len(MODULES) > 40


def test_the_reader_of_imports_sees_them() -> None:
    assert {"objects.mesh", "types", "kernels.rays"} <= imports_of(ROOT / "virtual_grasp.py")
    assert "objects.mesh" in imports_of(ROOT / "kernels" / "rays.py")
    assert "model" not in units_imported(ROOT / "hands" / "kinematics.py")
    assert "controller" in units_imported(ROOT / "__init__.py")
    assert "controller" not in units_imported(ROOT / "__init__.py", typing=False)


@every_module
def test_imports_go_downward(path: Path) -> None:
    unit = unit_of(path)
    for other in units_imported(path):
        assert other in LEVEL, f"{unit} imports {other}, which has no level"
        assert LEVEL[other] <= LEVEL[unit], f"{unit} (level {LEVEL[unit]}) imports {other} ({LEVEL[other]})"
        if LEVEL[unit] == 1 and LEVEL[other] == 1:
            assert (unit, other) in {("kernels", "objects"), ("hands", "objects"), ("objects", "clouds")}, (
                f"{unit} imports {other}"
            )


def test_no_stage_imports_another_stage() -> None:
    stages = {unit_of(path): units_imported(path) & STAGES for path in MODULES if unit_of(path) in STAGES}
    assert stages == {stage: set() for stage in STAGES}


def test_only_what_draws_imports_the_viewer() -> None:
    assert {unit_of(path) for path in MODULES if "viewer" in units_imported(path)} <= DRAWING


def test_the_viewer_knows_values_objects_and_hands_only() -> None:
    known = set().union(*(units_imported(path) for path in MODULES if unit_of(path) == "viewer"))
    assert known
    assert known <= {"exceptions", "types", "objects", "hands"}


def test_no_circle() -> None:
    edges = {unit: set() for unit in LEVEL}
    for path in MODULES:
        edges[unit_of(path)] |= units_imported(path, typing=False) - {"__init__"}
    edges["__init__"] = set()
    done: list[str] = []
    while len(done) < len(edges):
        free = [unit for unit, needs in edges.items() if unit not in done and needs <= set(done)]
        assert free, f"a circle among {sorted(set(edges) - set(done))}"
        done += free


@every_module
def test_nothing_heavy_is_imported_below_a_module_that_the_package_always_loads(path: Path) -> None:
    # The units that `import preshape` and the command line's --help load whole.
    light = {"exceptions", "types", "fuzzy", "planes", "wrench", "spatial", "tasks", "_version"}
    if unit_of(path) in light | {"__init__", "__main__"}:
        for node in ast.walk(tree_of(path)):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            assert not {name.split(".")[0] for name in names} & set(HEAVY)


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


def test_the_check_for_heavy_libraries_can_fail() -> None:
    assert loaded_after("import trimesh") >= {"trimesh"}


def test_public_names() -> None:
    assert len(preshape.__all__) == len(set(preshape.__all__)) <= 32
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
    tree = tree_of(ROOT / "__init__.py")
    guarded = for_typing_only(tree)
    for_checkers = {
        (a.asname or a.name): node.module
        for node in guarded
        if isinstance(node, ast.ImportFrom)
        for a in node.names
    }
    assert for_checkers == preshape._HOME
    assert set(preshape.__all__) == {*preshape._HOME, "__version__"}


def test_star_import_gives_exactly_the_public_names() -> None:
    space: dict[str, object] = {}
    exec("from preshape import *", space)  # noqa: S102
    assert set(space) - {"__builtins__"} == set(preshape.__all__)


@every_module
def test_every_all_is_real(path: Path) -> None:
    tree = tree_of(path)
    listed = [
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign)
        and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets)
    ]
    if listed and path != ROOT / "__init__.py":
        name = ".".join(("preshape", *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__")
        module = __import__(name, fromlist=["_"])
        assert all(hasattr(module, entry) for entry in listed[0])


@every_module
def test_no_module_is_longer_than_400_lines(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 400


def test_half_of_the_modules_are_short() -> None:
    lengths = [len(p.read_text(encoding="utf-8").splitlines()) for p in MODULES]
    assert statistics.median(lengths) <= 200


@every_module
def test_every_public_thing_has_a_docstring(path: Path) -> None:
    tree = tree_of(path)
    assert ast.get_docstring(tree), "the module has none"
    missing = []

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

    visit(tree.body, "")
    assert not missing


@every_module
def test_what_is_forbidden_everywhere(path: Path) -> None:
    assert unit_of(path) not in {"utils", "helpers", "common", "misc"}
    assert path.stem not in {"utils", "helpers", "common", "misc"}
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = {a.name.split(".")[0] for a in node.names} | {
                (getattr(node, "module", "") or "").split(".")[0]
            }
            assert not names & {"pickle", "marshal", "shelve", "dill", "joblib"}
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in {"eval", "exec", "compile"}
