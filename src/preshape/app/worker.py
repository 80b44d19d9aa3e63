"""The planner in a process of its own, one for each browser: requests and replies are lines of JSON.

Killed at any moment it loses nothing that the memory has acknowledged; so cancelling is killing, and neither
a broken mesh nor a long search touches the server or another browser. Requests, each with a number ``id``:

- ``{"do": "load", "source", "unit", "scale"}`` gives ``{"mesh"}``, reduced for the eye;
- ``{"do": "plan" | "teach", ...}`` (see :class:`Order`) gives ``{"document", "rays", "whole"}``, first with
  the answer alone, then again with every alternative that the hand has tried;
- ``{"do": "simulate", "source", "unit", "scale", "hand", "friction", "mass"}``, the hand being an answer's in
  JSON, gives ``{"run"}`` (see :func:`~preshape.app.physics_run.hold_run`).

Every reply repeats the ``id``; ``{"progress", "share"}`` come between; the last is ``{"done": true}`` or
``{"error": sentence}``.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from collections.abc import Callable
from dataclasses import fields
from typing import Any

from ..exceptions import PreshapeError
from ..hiis.fuzzy import FuzzySets
from ..types import ContactCoefficients, freeze, frozen_array, value
from .wire_format import encoded

ALTERNATIVES = 5
"""Other answers that are looked for."""

USUAL = ContactCoefficients()

Say = Callable[[dict[str, Any]], None]


@value
class Order:
    """What is to be planned.

    Attributes:
        source: a library object, or a mesh file.
        unit: of the file.
        scale: factor on the size.
        task: a name, or six numbers as text.
        hand: its name.
        analyser: ``rays`` or ``closure``.
        estimation: the critic's threshold, 0..6.
        recognition: from which match an object counts as known, 0..6.
        friction: for the closure analyser.
        mass: of the object, for the closure analyser [kg].
        approaches: allowed approach axes, as ``+z,-x``; empty for all.
        memory: its file; ``None`` for the user's.
        corners: 28 numbers, four corners of each membership function.
        shape: of the membership functions.
        coefficients: ka, ko, kn, mn of the contact model.
    """

    source: str
    unit: str = "m"
    scale: float = 1.0
    task: str = "lift"
    hand: str = "utah_mit"
    analyser: str = "rays"
    estimation: float = 3.0
    recognition: float = 5.0
    friction: float = 0.6
    mass: float = 0.1
    approaches: str = ""
    memory: str | None = None
    corners: tuple[float, ...] = tuple(float(c) for c in FuzzySets().corners.ravel())
    shape: str = FuzzySets().shape
    coefficients: tuple[float, ...] = (USUAL.ka, USUAL.ko, USUAL.kn, USUAL.mn)

    def __post_init__(self) -> None:
        freeze(self, corners=tuple(self.corners), coefficients=tuple(self.coefficients))

    @property
    def sets(self) -> FuzzySets:
        """The membership functions."""
        return FuzzySets(corners=frozen_array(self.corners, (28,), "corners").reshape(7, 4), shape=self.shape)

    @property
    def contact(self) -> ContactCoefficients:
        """The contact model's coefficients."""
        ka, ko, kn, mn = frozen_array(self.coefficients, (4,), "contact coefficients")
        return ContactCoefficients(ka=ka, ko=ko, kn=kn, mn=mn)


def order_fields(order: Order) -> dict[str, Any]:
    """An order as plain values."""
    return {f.name: getattr(order, f.name) for f in fields(Order)}


class Worker:
    """Answers requests one after the other; keeps the last object and its rays.

    Args:
        say: sends a reply.
    """

    def __init__(self, say: Say) -> None:
        self.say = say
        self._mesh: tuple[Any, Any] | None = None
        self._element: tuple[Any, Any] | None = None

    def answer(self, request: dict[str, Any]) -> None:
        """Do what a request says; errors become a reply."""
        number = request.get("id")

        def say(reply: dict[str, Any]) -> None:
            self.say({**reply, "id": number})

        try:
            if request["do"] == "load":
                self._load(request, say)
            elif request["do"] == "simulate":
                self._simulate(request, say)
            else:
                order = Order(**{k: v for k, v in request.items() if k not in ("do", "id")})
                self._plan(order, say, teach=request["do"] == "teach")
            say({"done": True})
        except PreshapeError as error:
            say({"error": str(error)})
        except MemoryError:
            say({"error": "not enough memory for this object; simplify the mesh"})
        except Exception as error:
            say({"error": f"internal fault ({type(error).__name__}: {error}); please report it"})

    def _load(self, request: dict[str, Any], say: Say) -> None:
        from .scenes import light_mesh

        say({"progress": "reading the object", "share": 20})
        mesh = self._object(request["source"], request["unit"], request["scale"])
        light = light_mesh(mesh)
        say(
            {
                "mesh": {
                    "name": mesh.name,
                    "vertices": encoded(light.vertices, "<f8"),
                    "triangles": encoded(light.triangles, "<i8"),
                    "whole": len(mesh.triangles),
                    "extents": mesh.extents.tolist(),
                }
            }
        )

    def _simulate(self, request: dict[str, Any], say: Say) -> None:
        from ..hands.load import load_hand
        from .physics_run import hold_run

        mesh = self._object(request["source"], request["unit"], request["scale"])
        hand = load_hand(request["hand"]["name"])
        run = hold_run(
            hand,
            mesh,
            request["hand"],
            friction=float(request["friction"]),
            mass=float(request["mass"]),
            progress=lambda words, share: say({"progress": words, "share": share}),
        )
        say({"run": run})

    def _plan(self, order: Order, say: Say, *, teach: bool) -> None:
        from ..hands.load import load_hand
        from ..hiis.analyser import VirtualGrasp
        from ..hiis.controller import Controller
        from ..hiis.critic import Thresholds
        from ..hiis.decision import Settings
        from ..memory import Memory
        from ..planner import Plan, check_analyser, execute, layout_of
        from ..planning.document import plan_to_json
        from ..tasks import parse_task

        start = time.perf_counter()
        say({"progress": "reading object, task and hand", "share": 5})
        mesh = self._object(order.source, order.unit, order.scale)
        hand, task = load_hand(order.hand), parse_task(order.task)
        kind = check_analyser(order.analyser, order.hand)
        layout = layout_of(hand)
        settings = Settings(
            thresholds=Thresholds(estimation=order.estimation, recognition=order.recognition),
            sets=order.sets,
            coefficients=order.contact,
        )
        say({"progress": "waking the memory (a hand's first time: a lesson with the cube)", "share": 12})
        loaded = time.perf_counter()
        with Memory.open(order.memory) as store:
            if kind == "closure":
                controller = self._closing(store, hand, layout, settings, order, task.gravity)
                element = controller.prepare(mesh)
            else:
                controller = Controller(store, layout, settings=settings)
                key = (id(mesh), order.hand, order.corners, order.shape, order.coefficients)
                if self._element is None or self._element[0] != key:
                    self._element = key, controller.prepare(mesh)
                element = self._element[1]
            prepared = time.perf_counter()
            allowed = order.approaches or None
            if teach:
                say({"progress": "mode 3: exploring all planes and learning", "share": 35})
                decision = controller.teach(element, task, approaches=allowed)
            else:
                say({"progress": "modes 0 to 3: looking for grasps that match", "share": 35})
                decision = controller.run(element, task, approaches=allowed, count=1 + ALTERNATIVES)
        found = [decision.grasp] if decision.grasp is not None else []
        found += list(decision.alternatives)
        answers: list[Any] = []
        for k, grasp in enumerate(found or [None]):
            if grasp is not None:
                share = 60 + 40 * k // len(found)
                say({"progress": f"the hand tries answer {k + 1} of {len(found)}", "share": share})
                answers.append(execute(hand, mesh, grasp))
            end = time.perf_counter()
            made = Plan(
                mesh=mesh,
                source=order.source,
                hand=hand,
                settings=settings,
                decision=decision,
                answer=answers[0] if answers else None,
                alternatives=tuple(answers[1:]),
                seconds={
                    "load": loaded - start,
                    "prepare": prepared - loaded,
                    "search": end - prepared,
                    "total": end - start,
                },
            )
            rays = [a.grasp.ray_origins.tolist() for a in answers if isinstance(a.grasp, VirtualGrasp)]
            whole = len(answers) == len(found)
            say({"document": plan_to_json(made), "rays": rays, "whole": whole})

    def _closing(self, store: Any, hand: Any, layout: Any, settings: Any, order: Order, gravity: Any) -> Any:
        from ..closure.settings import ClosureSettings
        from ..closure_control import closure_controller

        closure = ClosureSettings(friction=order.friction, mass=order.mass)
        return closure_controller(store, hand, layout, settings=settings, closure=closure, gravity=gravity)

    def _object(self, source: str, unit: str, scale: float) -> Any:
        from ..objects.load import load_object

        key = (source, unit, scale)
        if self._mesh is None or self._mesh[0] != key:
            self._mesh = key, load_object(source, unit=unit, scale=scale)
        return self._mesh[1]


def main() -> None:
    """Serve until standard input ends; what libraries print goes to standard error."""
    replies = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)

    def say(reply: dict[str, Any]) -> None:
        replies.write(json.dumps(reply) + "\n")
        replies.flush()

    try:
        # Imported before the first click, so that it is answered at once.
        for name in ("..hiis.controller", "..planning.document", "..memory", "..planner", "..kernels.rays"):
            importlib.import_module(name, __package__)
        for name in ("scipy.optimize", "scipy.spatial", "trimesh", "embreex.rtcore_scene", "mujoco", "fcl"):
            importlib.import_module(name)
        worker = Worker(say)
        say({"ready": True})
        for line in sys.stdin:
            worker.answer(json.loads(line))
    except (BrokenPipeError, KeyboardInterrupt):
        pass


if __name__ == "__main__":
    main()
