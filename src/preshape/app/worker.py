"""The planner in its own process, one for each browser; requests and replies are lines of JSON.

The worker can be killed at any time: whatever the memory has acknowledged is already stored. Work is
therefore cancelled by killing the process, and a broken mesh or a long search affects neither the server nor
another browser. Each message has a number ``id``. Here ``request`` is a
:class:`~preshape.planning.request.PlanRequest` as JSON:

- ``{"do": "load", "request"}`` gives ``{"mesh"}``, reduced for display;
- ``{"do": "plan" | "teach", "request"}`` gives ``{"document", "rays", "whole"}``, first with the answer
  alone, then again after each alternative that the hand has tried; ``whole`` is true in the last one;
- ``{"do": "simulate", "request", "answer"}``, where ``answer`` is an answer's JSON, gives ``{"run"}`` (see
  :func:`~preshape.app.physics_run.answer_run`).

Every reply repeats the ``id``. In between there are replies ``{"progress", "share"}``; the last reply is
``{"done": true}`` or ``{"error": sentence}``.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from ..exceptions import PreshapeError
from ..types import IntArray
from .wire_format import encoded

if TYPE_CHECKING:
    from ..objects.mesh import TriangleMesh
    from ..planning.plan import Plan
    from ..planning.request import PlanRequest
    from ..planning.session import Session

Say = Callable[[dict[str, Any]], None]


class Worker:
    """Answers messages one after the other, with one planning session for each memory file.

    Args:
        say: Function that sends a reply.
    """

    def __init__(self, say: Say) -> None:
        self.say = say
        self._number: Any = None
        self._sessions: dict[str | None, Session] = {}

    def answer(self, message: dict[str, Any]) -> None:
        """Do the work that a message requests; an error is sent as a reply."""
        from ..planning.request import PlanRequest

        self._number = message.get("id")
        try:
            request = PlanRequest.from_json(message["request"])
            session = self._session(request)
            if message["do"] == "load":
                self._load(session, request)
            elif message["do"] == "simulate":
                self._simulate(session, request, message["answer"])
            elif message["do"] == "teach":
                self._tell(session.teach(request), whole=True)
            else:
                plan = session.run(request, partial=lambda plan: self._tell(plan, whole=False))
                self._tell(plan, whole=True)
            self._reply({"done": True})
        except PreshapeError as error:
            self._reply({"error": str(error)})
        except MemoryError:
            self._reply({"error": "not enough memory for this object; simplify the mesh"})
        except Exception as error:
            fault = f"{type(error).__name__}: {error}"
            self._reply({"error": f"internal fault ({fault}); please report it"})

    def close(self) -> None:
        """Close the memories."""
        for session in self._sessions.values():
            session.close()
        self._sessions.clear()

    def _session(self, request: PlanRequest) -> Session:
        from ..planning.session import Session

        if request.memory not in self._sessions:
            self._sessions[request.memory] = Session(request.memory, progress=self._progress)
        return self._sessions[request.memory]

    def _reply(self, reply: dict[str, Any]) -> None:
        self.say({**reply, "id": self._number})

    def _progress(self, words: str, share: float) -> None:
        self._reply({"progress": words, "share": share})

    def _tell(self, plan: Plan, *, whole: bool) -> None:
        from ..planning.document import plan_to_json
        from ..planning.output import ray_origins

        self._reply({"document": plan_to_json(plan), "rays": ray_origins(plan), "whole": whole})

    def _load(self, session: Session, request: PlanRequest) -> None:
        from ..pictures import light_mesh

        self._progress("reading the object", 20)
        mesh = session.mesh(request)
        light = light_mesh(mesh)
        self._reply(
            {
                "mesh": {
                    "name": mesh.name,
                    "vertices": encoded(light.vertices, "<f8"),
                    "triangles": encoded(light.triangles, "<i8"),
                    "whole": len(mesh.triangles),
                    "extents": mesh.extents.tolist(),
                    "parts": [part.name for part in mesh.parts],
                    "part_of": encoded(_parts_drawn(mesh, light), "<i8"),
                }
            }
        )

    def _simulate(self, session: Session, request: PlanRequest, answer: dict[str, Any]) -> None:
        from ..hands.load import recorded_hand
        from ..planning.grasp_sets import planned_for
        from .physics_run import answer_run

        planned = planned_for(answer)
        run = answer_run(
            recorded_hand(answer["hand"]),
            session.mesh(request),
            answer["hand"],
            friction=planned.friction,
            mass=planned.mass,
            job=planned.job,
            progress=self._progress,
        )
        self._reply({"run": run})


def _parts_drawn(mesh: TriangleMesh, light: TriangleMesh) -> IntArray:
    """(k,) index of the part of each drawn triangle, -1 for none."""
    from ..objects.parts import part_of_triangles

    whole = part_of_triangles(mesh)
    if light is mesh:
        return whole
    from scipy.spatial import cKDTree

    _, nearest = cKDTree(mesh.corners.mean(axis=1)).query(light.corners.mean(axis=1))
    return np.asarray(whole[nearest])


def main() -> None:
    """Serve until standard input ends."""
    lines, replies = message_pipes()

    def say(reply: dict[str, Any]) -> None:
        replies.write(json.dumps(reply) + "\n")
        replies.flush()

    try:
        # These modules are imported in advance, so that the first click is answered at once.
        for name in ("..planning.session", "..planning.output", "..pictures", "..kernels.rays"):
            importlib.import_module(name, __package__)
        for name in ("scipy.optimize", "scipy.spatial", "trimesh", "embreex.rtcore_scene", "mujoco", "fcl"):
            importlib.import_module(name)
        worker = Worker(say)
        say({"ready": True})
        while True:
            worker.answer(json.loads(lines.get()))
    except (BrokenPipeError, KeyboardInterrupt):
        pass


def message_pipes() -> tuple[SimpleQueue[str], TextIO]:
    """The lines of standard input as they come, and standard output, whose other uses go to standard error.

    When standard input ends, so does this process.
    """
    lines: SimpleQueue[str] = SimpleQueue()
    threading.Thread(target=_read, args=(lines,), daemon=True).start()
    replies = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    return lines, replies


def _read(lines: SimpleQueue[str]) -> None:
    """Queue the lines of standard input; when it ends, so does this process, whatever it is doing.

    The server that is killed leaves no planner behind that goes on for minutes.
    """
    for line in sys.stdin:
        lines.put(line)
    os._exit(0)


if __name__ == "__main__":
    main()
