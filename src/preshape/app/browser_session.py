"""One browser: connects its panel, its scene and its planner process."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..exceptions import PreshapeError
from ..hiis.planes import plane
from ..objects.library import names as object_names
from ..objects.mesh import TriangleMesh
from ..pictures import Document
from ..planning.request import PlanRequest
from ..report.plain import html_text as escape
from ..types import value
from ..viewer import readings
from .left_page import LeftPage
from .link import PlannerLink, Reply
from .memory_browser import memory_html, memory_place
from .panel import ACCEPT, Panel
from .playback import Playback
from .reading import Reading
from .stage import Stage
from .steering import Steering
from .trial import Trial
from .uploads import Receiver, Uploads
from .waiting import Waiting
from .wire_format import decoded

if TYPE_CHECKING:
    import viser


@value
class Start:
    """What a browser shows first.

    Attributes:
        request: Object, task, hand and settings.
        document: A plan to show, whose request is ``request``; ``None`` if no plan was given.
        at_once: Whether a new page plans as soon as its object is there.
    """

    request: PlanRequest
    document: Document | None = None
    at_once: bool = False


class BrowserSession:
    """The state of one browser; browsers share only the memory file.

    Args:
        client: The browser.
        start: What a new page shows first.
        left: What the page showed when its connection ended; ``None`` for a new page. Its uploads become
            this session's.
    """

    def __init__(self, client: viser.ClientHandle, start: Start, left: LeftPage | None = None) -> None:
        self._client, self._start, self._begun = client, start, left
        self._lock = threading.RLock()
        self._uploads = left.uploads if left else Uploads()
        self._uploaded = {name: Path(path) for name, path in left.uploaded} if left else {}
        Receiver(client, self._uploads, self._received, self._refused)
        self._planner = PlannerLink(self._heard)
        self._deadlock = False
        # The request with the shown object, and the request with the object that is being loaded.
        self._loaded: PlanRequest | None = None
        request = self._pending = left.request if left else start.request
        self._after: Callable[[], None] | None = None
        # What follows when the work in progress is done, and what that work is.
        self._next: Callable[[], None] | None = None
        self._work = ""
        place = escape(memory_place(start.request.memory))
        self.panel = Panel(
            client.gui,
            request,
            place,
            objects=(start.request.object_name, *self._uploaded),
            label=left.object_label if left else "",
        )
        self.stage = Stage(client, self._picked, self._part_picked)
        self.reading = Reading(self.panel, self.stage)
        self.steering = Steering(self.panel, self.stage)
        self.trial = Trial(self.panel, self.stage)
        self.playback = Playback(self.panel, self.stage, self.reading, self.trial)
        self._waiting = Waiting(self.panel, self._say)
        self._wire()
        self._say("warn", "Welcome", "Choose an object and a task, then press Plan.")
        self._recall()
        self.steering.show_task()
        self.steering.show_load()
        with self._reported():
            self._planner.start()
            if left is not None:
                self._after = partial(self._restore, left)
            elif start.document is not None:
                self._after = self._show_given
            elif start.at_once:
                self._next = partial(self._plan, "plan")
            self._load(request)

    def left(self) -> LeftPage | None:
        """What is to be kept of the page when its connection has ended; ``None`` if it shows nothing yet."""
        with self._lock:
            if self._loaded is None:  # it closes before it is what it was
                return self._begun.shared() if self._begun else None
            try:
                request = self.steering.request(self._loaded)
            except PreshapeError:  # numbers that are half typed
                request = self._loaded
            rays, shown, rejected = self.reading.state
            return LeftPage(
                request=request,
                object_label=str(self.panel.object.value),
                document=self.reading.document,
                rays=tuple(rays),
                shown=shown,
                rejected=rejected,
                deadlock=self._deadlock,
                work=self._work if self._work in ("plan", "teach") else "",
                run=self.trial.run,
                uploads=self._uploads.shared(),
                uploaded=tuple((name, str(path)) for name, path in self._uploaded.items()),
            )

    def close(self) -> None:
        """Release all resources, because the browser has disconnected."""
        self.playback.stop()
        self._planner.close()
        self._waiting.end()
        self._uploads.close()

    # Wiring.

    def _wire(self) -> None:
        p = self.panel

        def on(handle: Any, act: Callable[[], None]) -> None:
            def called(event: Any) -> None:
                if event.client is not None:  # no client: the program itself has set the value
                    with self._reported():
                        act()

            (handle.on_click if hasattr(handle, "on_click") else handle.on_update)(called)

        on(p.object, self._choose_object)
        on(p.unit, self._choose_object)
        steering = self.steering
        on(p.task, steering.show_task)
        on(p.axis, steering.show_task)
        for slider in p.numbers:
            on(slider, steering.use_numbers)
        on(p.drag, steering.switch_gizmo)
        on(p.hand, steering.choose_hand)
        for handle in (p.analyser, p.verify, p.table, p.height, p.avoid):
            on(handle, steering.show_load)
        p.tuning.wire(on)
        on(p.simulate, self._simulate)
        on(p.moment, self.playback.seek)
        on(p.replay, self.playback.replay)
        on(p.film, self._film)
        on(p.run, lambda: self._plan("plan"))
        on(p.teach, lambda: self._plan("teach"))
        on(p.cancel, self._cancel)
        on(p.reset, self._reset)
        on(p.verdict, self._judge)
        on(p.slider, self.playback.slide)
        on(p.play, self.playback.play)
        on(p.memory_reload, self._recall)
        on(p.camera, self.stage.look)
        on(p.glass, lambda: self.stage.glass(p.glass.value, self.reading.share()))
        on(p.glass_object, lambda: self.stage.glass_object(p.glass_object.value))
        for i, button in enumerate(p.offers):
            on(button, partial(self._take_offer, i))
        for i, button in enumerate(p.answers):
            on(button, partial(self._show_answer, i))
        for group, box in p.layers.items():
            on(box, partial(self._layer, group))
            self.stage.layer(group, box.value)

    def _layer(self, group: str) -> None:
        self.stage.layer(group, bool(self.panel.layers[group].value))

    @contextlib.contextmanager
    def _reported(self) -> Iterator[None]:
        """Show an error as the headline, so that the browser stays usable."""
        try:
            yield
        except PreshapeError as error:
            self._say("bad", "This does not work", str(error))
        except Exception as error:
            self._say("bad", "Internal fault", f"{type(error).__name__}: {error}; please report it")

    def _say(self, kind: str, title: str, words: str) -> None:
        text = f'<div class="head {kind}"><b>{escape(title)}</b>{escape(words)}</div>'
        self.panel.headline.content = readings.wrapped(text)

    # Steering.

    def _choose_object(self) -> None:
        name = self.panel.object.value
        if name in self._uploaded:
            self._load(self._changed(str(self._uploaded[name]), self.steering.unit))
        elif name == self._start.request.object_name:
            self._load(self._start.request)
        elif name in object_names():
            self._load(self._changed(name, "m"))

    def _changed(self, source: str, unit: str) -> PlanRequest:
        """The first request with another object."""
        asked = replace(self._start.request, hold_on=(), keep_off=())  # the parts of the first object
        return replace(asked, source=source, unit=unit, scale=1.0, view=None, cut_table=None, mask=None)

    def _received(self, path: Path) -> None:
        """Load an upload, in a thread of its own: the caller is the server's event loop."""
        threading.Thread(target=self._upload, args=(path,), daemon=True).start()

    def _refused(self, words: str) -> None:
        self._say("bad", "This does not work", words)

    def _upload(self, path: Path) -> None:
        with self._reported():
            with self._lock:
                label = f"{path.stem} (upload {path.parent.name})"
                self._uploaded[label] = path

            def arrived() -> None:
                self.panel.object.options = (*self.panel.object.options, label)
                self.panel.object.value = label

            self._after = arrived
            self._load(self._changed(str(path), self.steering.unit))

    def _load(self, request: PlanRequest) -> None:
        def ready() -> None:
            self._pending = request

        self._ask("reading the object", ready, "load", request=request.to_json())

    def _plan(self, do: str) -> None:
        if self._deadlock:
            self._say("bad", "Deadlock", "Reset it first, then ask for another task or object.")
            return
        if self._loaded is None:
            self._say("warn", "No object", "Choose an object first.")
            return
        request = self.steering.request(self._loaded)
        self._ask("planning", self._forget, do, request=request.to_json())

    def _ask(self, words: str, ready: Callable[[], None], do: str, **content: Any) -> None:
        """Send a message to the planner.

        Args:
            words: Description of the work, to display.
            ready: Called before the message is sent, because the planner may reply before this returns.
            do: Kind of work, such as ``plan``.
            content: The other fields of the message.
        """
        with self._lock:
            if self._planner.busy:
                words = "The planner is busy: wait until it is done, or cancel it."
                self._say("warn", "One request at a time", words)
                return
            ready()
            # A new answer takes over the headline; a run in physics gives no answer and keeps it.
            self._work = do
            self._waiting.begin(words, lambda: do == "simulate" or self.reading.document is None)
            try:
                self._planner.ask(do, **content)
            except PreshapeError:
                self._waiting.end()
                raise
        self._waiting.watch()

    def _cancel(self) -> None:
        if self._planner.cancel():
            self._after = self._next = None
            self._work = ""
            self._waiting.end()
            self._say("warn", "Cancelled", "Everything that was learnt before is kept.")

    # Replies of the planner.

    def _heard(self, reply: Reply) -> None:
        with self._reported():
            if {"mesh", "document", "run"} & reply.keys():
                self._waiting.quiet()
            if "progress" in reply:
                self._waiting.progress(str(reply["progress"]), float(reply["share"]))
            elif "mesh" in reply:
                self._arrived(reply["mesh"])
            elif "document" in reply:
                self._planned(reply)
            elif "run" in reply:
                self._show_run(reply["run"])
            elif "error" in reply:
                self._failed(str(reply["error"]))
            elif "done" in reply:
                self._done()

    def _arrived(self, sent: dict[str, Any]) -> None:
        mesh = TriangleMesh(
            name=sent["name"],
            vertices=decoded(sent["vertices"], "<f8", 3),
            triangles=decoded(sent["triangles"], "<i8", 3),
        )
        self._loaded = self._pending
        self._forget()
        self.stage.put(mesh, decoded(sent["part_of"], "<i8", 1)[:, 0])
        self.steering.show_parts(sent["parts"], self._pending)
        size = " × ".join(f"{1000 * x:.0f}" for x in sent["extents"])
        drawn = f", {len(mesh.triangles)} of them drawn" if len(mesh.triangles) < sent["whole"] else ""
        self._say("warn", sent["name"], f"{size} mm, {sent['whole']} triangles{drawn}. Press Plan.")
        after, self._after = self._after, None
        if after is not None:
            after()

    def _planned(self, reply: Reply) -> None:
        first = self.reading.document is None
        self.reading.take(reply["document"], reply.get("rays", []))
        if first:
            self._deadlock = bool(reply["document"].get("deadlock"))
            self.panel.reset.visible = self._deadlock
            self.stage.look()

    def _done(self) -> None:
        self._waiting.end()
        self._work = ""
        self._recall()
        following, self._next = self._next, None
        if following is not None:
            following()

    def _failed(self, words: str) -> None:
        self._waiting.end()
        self._after = self._next = None
        self._work = ""
        for name, path in list(self._uploaded.items()):
            if str(path) in words:
                words = words.replace(str(path), path.name)
                if name not in self.panel.object.options:
                    del self._uploaded[name]
        self._say("bad", "This does not work", words)

    def _forget(self) -> None:
        self.playback.stop()
        self.trial.drop()
        self.reading.forget()

    def _show_given(self) -> None:
        if self._start.document is not None:
            self.reading.take(self._start.document, [])
            self.stage.look()

    def _restore(self, left: LeftPage) -> None:
        """Show what the page showed; work that was in progress begins again."""
        if left.document is not None:
            self.reading.restore(left.document, list(left.rays), left.shown, left.rejected)
            self._deadlock = left.deadlock
            self.panel.reset.visible = left.deadlock
            self.stage.look()
            if left.run is not None:
                self.trial.take(left.run)
        if left.work:
            self._next = partial(self._plan, left.work)

    def _picked(self, index: int) -> None:
        with self._reported():
            self.stage.select(index)
            words = self.reading.pick(index)
            if words:
                self._say("warn", plane(index).label, words)

    def _part_picked(self, index: int) -> None:
        if words := self.steering.ask_for_part(index):
            self._say("warn", *words)

    def _recall(self) -> None:
        self.panel.memory.content = readings.wrapped(memory_html(self._start.request.memory))

    # The external critic.

    def _take_offer(self, index: int) -> None:
        offers = self.reading.offers
        if index >= len(offers):
            return
        self.steering.take(offers[index])
        self._plan("plan")

    def _judge(self) -> None:
        if self.panel.verdict.value == ACCEPT:
            self._accept()
        else:
            self._reject()

    def _accept(self) -> None:
        name = self.reading.title()
        for ending, content in self.reading.files().items():
            self._client.send_file_download(f"{name}.{ending}", content, save_immediately=True)
        self._say("good", "Accepted", f"{name}.json and {name}.html are among your downloads.")

    def _show_answer(self, index: int) -> None:
        self.trial.drop()
        self.reading.show(index)

    def _reject(self) -> None:
        self.trial.drop()
        if not self.reading.reject():
            words = "Ask for another task, or teach this object with this task."
            self._say("warn", "All answers rejected", words)

    def _reset(self) -> None:
        self._deadlock = False
        self.panel.reset.visible = False
        self._say("warn", "Deadlock reset", "Ask for another task or object.")

    # Simulated physics.

    def _film(self) -> None:
        """Play the run of the shown answer; if there is none yet, simulate it first."""
        if self.trial.run is not None:
            self.playback.replay()
        else:
            self._simulate(at_once=True)

    def _simulate(self, *, at_once: bool = False) -> None:
        answer = self.reading.answer
        if answer is None or self._loaded is None:
            self._say("warn", "Nothing to simulate", "Plan first.")
            return
        ready = partial(self.playback.begin, answer, at_once=at_once)
        self._ask("simulating", ready, "simulate", request=self._loaded.to_json(), answer=answer)

    def _show_run(self, run: dict[str, Any]) -> None:
        if self.playback.take(run):
            self._next = self.playback.follow
        else:
            words = "The answer that was simulated is no longer shown; simulate this one."
            self._say("warn", "Another answer", words)
