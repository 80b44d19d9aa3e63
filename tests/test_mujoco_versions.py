"""MuJoCo 4.0.0 and 4.0.1 give the same answers, because every model that is stepped has a dense Jacobian.

4.0.0 factorises sparse constraint Jacobians wrongly. It is allowed because other packages need it.
"""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import preshape
from preshape import load_hand, load_object
from preshape.export.mjcf import scene_mjcf
from preshape.export.planned import planned_grasps
from preshape.hands.kinematics import HandKinematics
from preshape.hands.load import hand_names
from preshape.physics.hand import physics_hand
from preshape.physics.pieces import ConvexPieces
from preshape.physics.protocol import HoldProtocol
from preshape.physics.scene import build_scene

HERE, ROOT = Path(__file__).parent, Path(preshape.__file__).parent
OLD, FOLDER = "4.0.0", Path(sys.prefix) / "mujoco-4.0.0"
DENSE, SPARSE = mujoco.mjtJacobian.mjJAC_DENSE, '<option jacobian="sparse"/>'
BOX = ConvexPieces(
    name="box", pieces=(np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.03,)
)


def simulated(path: str) -> dict:
    """What ``mujoco_run.py`` prints in a fresh interpreter that looks for modules in ``path`` first."""
    command = [sys.executable, str(HERE / "mujoco_run.py")]
    ran = subprocess.run(command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout)


def farthest(first: dict, second: dict) -> float:
    return float(np.abs(np.array(first["path"]) - np.array(second["path"])).max())


@pytest.mark.slow
def test_the_answers_of_both_versions_are_the_same() -> None:
    if not FOLDER.is_dir():
        pytest.fail(
            f"MuJoCo {OLD} is missing: say make test, or "
            f"{sys.executable} -m pip install --no-deps --target {FOLDER} mujoco-core=={OLD}"
        )
    old, new = simulated(str(FOLDER)), simulated("")
    assert (old["version"], new["version"]) == (OLD, mujoco.__version__)
    assert mujoco.__version__ != OLD, "constraints.txt asks for a later version"
    assert old["runs"].keys() == new["runs"].keys() >= {*hand_names(), "exported"}
    apart = {name: farthest(run, new["runs"][name]) for name, run in old["runs"].items()}
    # The control: with a sparse Jacobian the fault is there, and this comparison sees it.
    assert apart.pop("pile, sparse") > 0.1
    assert max(apart.values()) <= 1e-9, apart  # measured: 0
    for name in hand_names():
        assert old["runs"][name]["verdict"] == new["runs"][name]["verdict"] == "HELD"
        assert old["runs"][name]["probes"] == pytest.approx(np.array(new["runs"][name]["probes"]), abs=1e-9)


@pytest.mark.parametrize("name", hand_names())
def test_the_models_of_the_built_in_hands_have_dense_jacobians(name: str) -> None:
    hand = load_hand(name)
    assert HandKinematics(hand).model.opt.jacobian == DENSE
    for protocol in (HoldProtocol(), HoldProtocol(many_contacts=True)):
        assert build_scene(physics_hand(hand), BOX, 1.0, protocol).model.opt.jacobian == DENSE


def test_a_hand_that_asks_for_sparse_jacobians_is_simulated_with_dense_ones() -> None:
    hand = load_hand("shadow")
    sparse = replace(hand, mjcf=hand.mjcf.replace('<option jacobian="dense"/>', SPARSE))
    assert SPARSE in sparse.mjcf
    assert build_scene(physics_hand(sparse), BOX, 1.0, HoldProtocol()).model.opt.jacobian == DENSE
    document = json.loads((HERE / "data" / "shadow_mug_lift.json").read_text())
    (grasp, *_), _ = planned_grasps(document, "shadow_mug_lift.json")
    mesh = load_object("mug")
    pieces = ConvexPieces(name="mug", pieces=(mesh.vertices,))
    text = scene_mjcf(replace(grasp, hand=sparse), mesh, pieces)
    assert mujoco.MjModel.from_xml_string(text).opt.jacobian == DENSE


def test_a_scene_without_a_hand_has_a_dense_jacobian() -> None:
    assert build_scene(None, BOX, 1.0, HoldProtocol()).model.opt.jacobian == DENSE


def test_only_the_scenes_of_physics_are_stepped() -> None:
    """The list of all places that make or step a model; a new one belongs into the tests above."""
    builds, steps = set(), set()
    for file in sorted(ROOT.rglob("*.py")):
        called = {
            node.func.attr
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
        }
        name = file.relative_to(ROOT).as_posix()
        if called & {"from_xml_string", "from_xml_path", "from_binary_path"} or (
            "compile" in called and "MjSpec" in file.read_text(encoding="utf-8")
        ):
            builds.add(name)
        if any(
            call.startswith(("mj_step", "mj_forward", "mj_fwd", "mj_inverse", "rollout")) for call in called
        ):
            steps.add(name)
    assert builds == {
        "export/mjcf.py",  # what others will step: tested above
        "export/usd.py",  # the same scene, placed and written, never stepped
        "hands/compiled.py",  # a foreign model: read, placed, never stepped
        "hands/kinematics.py",
        "hands/rewrite.py",
        "hands/trial.py",  # a hand with a cylinder and a cube: placed, never stepped
        "physics/scene.py",
    }
    assert steps == {
        "physics/hold/recording.py",
        "physics/hold/six_directions.py",
        "physics/measures.py",
        "physics/pick/doing.py",  # the scene that pick_up has built and stepped
        "physics/pick/picking.py",
        "physics/scene.py",
        "physics/task/protocol.py",
    }
