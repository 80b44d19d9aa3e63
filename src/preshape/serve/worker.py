"""The planner process of the server: warm, with what the last requests needed still prepared.

It speaks lines of JSON like the app's planner process (:mod:`preshape.app.worker`), and ends with the server.
Each message has a number ``id``, which its replies repeat:

- ``{"do": "plan", "request", "names"}`` gives ``{"text", "done"}``: the plan as JSON text;
- everything else is for the caller of :func:`serve`.

The last reply is ``{"done": true, …}``, or ``{"error": sentence, "exit": code}`` with the exit code that the
command line gives for this error.
"""

from __future__ import annotations

import importlib
import json
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from ..app.worker import message_pipes
from ..exceptions import EnvironmentFailure, InputError, PreshapeError

if TYPE_CHECKING:
    from ..planning.request import PlanRequest
    from ..planning.session import Session

Say = Callable[[dict[str, Any]], None]
SESSIONS, ANSWERS = 16, 16
"""Number of objects, each with hand and task, that stay prepared in a process, and of answers for each."""
MOST_ANSWERS, MOST_THREADS, MOST_CANDIDATES = 100, 256, 100_000
"""Largest numbers that a request may ask for: what takes more memory is for the command line."""
_USED = (
    "preshape.planning.session", "preshape.planning.document", "preshape.planning.keywords",
    "preshape.closure.analyser", "preshape.kernels.rays", "scipy.optimize", "scipy.spatial", "scipy.ndimage",
    "trimesh", "embreex.rtcore_scene", "mujoco", "fcl",
)  # fmt: skip


class _Warm:
    """A session, and its answers with the state of memory and files that each is for."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.answers: OrderedDict[str, tuple[Any, str]] = OrderedDict()


class WarmPlanner:
    """Plans requests over one memory, and keeps what it prepared for the last of them.

    The answer depends on the request, the memory and the files alone. So a request that comes again, while
    none of them has changed, gets the same plan without another search.

    Args:
        memory: The memory's file; ``None`` for the user's.
    """

    def __init__(self, memory: str | None) -> None:
        self.memory = memory
        self._sessions: OrderedDict[str, _Warm] = OrderedDict()

    def plan(self, data: object, names: dict[str, str]) -> str:
        """The plan for a request, as JSON text without line breaks.

        Args:
            data: The request as JSON.
            names: For files of the server that the client does not know, their names in the plan.

        Raises:
            InputError: Something in the request cannot be used.
            EnvironmentFailure: A file cannot be read or written.
        """
        from ..planning.document import plan_to_json
        from ..planning.keywords import request_from_keywords

        request = request_from_keywords(data, memory=self.memory)
        _check_size(request)
        warm = self.session(request)
        key, before = json.dumps([request.to_json(), names]), warm.session.inputs(request)
        known = warm.answers.pop(key, None)
        if known is not None and before is not None and known[0] == before:
            warm.answers[key] = known
            return known[1]
        document = plan_to_json(warm.session.run(request))
        best = document["best"]
        for one in (document, *document["alternatives"], *([best] if best else [])):
            one["object"]["source"] = names.get(one["object"]["source"], one["object"]["source"])
        asked = document["request"]
        asked["object"]["source"] = names.get(asked["object"]["source"], asked["object"]["source"])
        text = json.dumps(document, allow_nan=False)
        # A plan that has taught the memory something is followed by another one.
        if before is not None and warm.session.inputs(request) == before:
            warm.answers[key] = before, text
            while len(warm.answers) > ANSWERS:
                warm.answers.popitem(last=False)
        return text

    def session(self, request: PlanRequest) -> _Warm:
        """The session of the last answer for this object, hand and task, or a new one."""
        from ..planning.session import Session

        asked = request.to_json()
        key = json.dumps([asked[name] for name in ("object", "hand", "analyser", "task", "learn", "memory")])
        found = self._sessions.pop(key, None)
        if found is None:
            found = _Warm(Session(request.memory, learn=request.learn))
            while len(self._sessions) >= SESSIONS:
                self._sessions.popitem(last=False)[1].session.close()
        self._sessions[key] = found
        return found

    def warm(self, hands: Sequence[str]) -> None:
        """Import, load and compile what plans need, and each hand's tables."""
        from ..closure.settings import ClosureSettings
        from ..hands.load import load_hand
        from ..hiis.analyser import Aim
        from ..objects.library import load_library_object
        from ..planning.controllers import closure_analyser
        from ..planning.request import PlanRequest

        small = ClosureSettings(
            everywhere=64, wraps=64, elite=4, children=2, rounds=1, finished=1, persistence=0
        )
        for name in hands:
            request = PlanRequest(source="cube", task="lift", hand=name, analyser="closure", search=small)
            element = closure_analyser(request, load_hand(name), load_library_object("cube"))
            element.explore(request.asked.q, Aim(values=[0.0], fingers=[2, 3]))

    def close(self) -> None:
        """Close the memories."""
        for warm in self._sessions.values():
            warm.session.close()
        self._sessions.clear()


def _check_size(request: PlanRequest) -> None:
    """Refuse a request that takes more memory or threads than a client may use.

    Raises:
        InputError: A number is too large.
    """
    search = request.search
    for name, number, most in (
        ("count", request.count, MOST_ANSWERS),
        ("search.threads", search.threads or 0, MOST_THREADS),
        *(
            (f"search.{name}", getattr(search, name), MOST_CANDIDATES)
            for name in ("at_aim", "on_plane", "everywhere", "wraps", "elite", "children", "finished")
        ),
    ):
        if number > most:
            raise InputError(
                f"{name} may be at most {most} over HTTP, got {number}; use preshape plan for more"
            )


def serve(answer: Callable[[dict[str, Any], Say], None], warm: Callable[[], None]) -> None:
    """Answer messages one after the other until standard input ends.

    Standard output of everything else goes to standard error.

    Args:
        answer: Answers a message by replies; its last reply has ``done`` or ``error``.
        warm: Called before the first message is answered.
    """
    lines, replies = message_pipes()
    lock = threading.Lock()
    number: Any = None

    def say(reply: dict[str, Any]) -> None:
        text = json.dumps({**reply, "id": number}) + "\n"
        with lock:  # a progress bar writes from a thread of its own
            replies.write(text)
            replies.flush()

    with suppress(BrokenPipeError, KeyboardInterrupt):
        for name in _USED:
            importlib.import_module(name)
        with suppress(PreshapeError):  # the first request says what is wrong
            warm()
        while True:
            message = json.loads(lines.get())
            number = message.get("id")
            try:
                answer(message, say)
            except PreshapeError as error:
                say({"error": str(error), "exit": error.exit_code})
            except MemoryError:
                words = "not enough memory for this object; simplify the mesh"
                say({"error": words, "exit": EnvironmentFailure.exit_code})
            except OSError as error:
                say({"error": f"the environment failed: {error.strerror or error}", "exit": 3})
            except Exception as error:
                fault = f"{type(error).__name__}: {error}"
                say({"error": f"internal fault ({fault}); please report it", "exit": 3})
