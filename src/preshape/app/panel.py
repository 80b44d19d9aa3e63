"""The widgets of a browser's panel; :mod:`.browser_session` connects them."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources
from typing import TYPE_CHECKING, Any

from ..hands.load import hand_names
from ..hiis.planes import AXIS_NAMES
from ..objects.library import names as object_names
from ..planning.request import ANALYSERS, PlanRequest
from ..planning.rules import FOLLOW
from ..planning.standing import AUTO
from ..tasks import family_names
from ..tasks.task import COMPONENTS
from ..types import FRICTION
from ..viewer.draw import GROUPS, HIDDEN
from ..viewer.readings import wrapped
from .tuning import Tuning

if TYPE_CHECKING:
    import viser

SIX = "six numbers"
ANY = "any"
USUAL = "usual"
UNITS = ("m", "cm", "mm", "in")
OFFERS = 3
ALTERNATIVES = 5
"""Number of requested answers in addition to the best one."""
ACCEPT, REJECT = VERDICTS = ("Accept", "Reject")
NO_TABLE, UNDER, AT_HEIGHT = TABLES = ("none", "under the object", "at a height")
EITHER, HOLD, KEEP_OFF = USES = ("may be touched", "hold here", "keep off")
"""What may be asked of a part."""
MOST_PARTS = 30
"""Number of parts that are offered; a file may have hundreds of groups."""
OWN_MASS = wrapped('<p class="quiet">Empty: the mass that the object has, else one from its volume.</p>')
TRIAL = (
    "The answer in simulated physics (MuJoCo), as preshape simulate runs it: on a table the hand comes in, "
    "closes, squeezes, lifts and does the task; without one it squeezes, and the object is pushed from six "
    "sides. Friction and mass are those that the answer was planned with. A scan takes up to two minutes the "
    "first time."
)


class Panel:
    """All widgets of one browser.

    Args:
        gui: The browser's panel.
        request: The request that the widgets show at first.
        memory: Location of the memory, to display.
        objects: Further names in the list of objects.
        label: Name of the request's object in that list; by default its own.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        request: PlanRequest,
        memory: str,
        *,
        objects: Sequence[str] = (),
        label: str = "",
    ) -> None:
        self.gui = gui
        self._label = label or request.object_name
        self._objects = list(dict.fromkeys([*object_names(), *objects, self._label]))
        gui.add_html(f"<style>{(resources.files('preshape.viewer') / 'web' / 'app.css').read_text()}</style>")
        self.headline = gui.add_html("")
        self.run_words = gui.add_html("")
        self.progress = gui.add_progress_bar(0, visible=False, animated=True)
        self.cancel = gui.add_button(
            "Cancel", visible=False, color="gray", hint="Stops the work; nothing that was learnt is lost"
        )
        self._critic(gui)
        self._motion(gui)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Plan"):
            self._steering(gui, request)
            self._load(gui, request)
            self._rules(gui, request)
            self._search(gui, request)
            self.run = gui.add_button("Plan", color="blue", hint="Runs modes 0 to 3")
            self.teach = gui.add_button(
                "Teach this object and task", color="gray", hint="Explores all planes and learns (mode 3)"
            )
        with tabs.add_tab("Why"):
            self.why = gui.add_html("")
        with tabs.add_tab("Answers"):
            self._answers(gui)
        with tabs.add_tab("Physics"):
            self._physics(gui)
        with tabs.add_tab("Tune"):
            self.tuning = Tuning(gui, request.settings)
        with tabs.add_tab("Memory"):
            self.memory = gui.add_html("")
            self.memory_reload = gui.add_button("Reload", color="gray")
            style = "font-size:11px;color:#59626D;overflow-wrap:anywhere;padding:0 10px"
            gui.add_html(f'<div style="{style}">{memory}</div>')
        with tabs.add_tab("Show"):
            self._layers(gui)

    def _critic(self, gui: viser.GuiApi) -> None:
        """Buttons of the external critic (the user), shown when a plan needs a decision."""
        self.offers = [gui.add_button(f"offer {i}", visible=False, color="orange") for i in range(OFFERS)]
        self.reset = gui.add_button(
            "Reset the deadlock", visible=False, color="orange", hint="Allows another task or object"
        )
        self.verdict = gui.add_button_group("Your verdict", VERDICTS, visible=False)

    def _motion(self, gui: viser.GuiApi) -> None:
        marks = ((0.0, "away"), (1.0, "open"), (2.0, "closed"), (3.0, "squeeze"))
        self.slider = gui.add_slider("Move hand", 0.0, 3.0, 0.05, 3.0, marks=marks, visible=False)
        self.play = gui.add_button("Play the grasp", visible=False, color="gray")
        self.film = gui.add_button(
            "Play the whole job",
            visible=False,
            color="gray",
            hint="In simulated physics: comes in, closes, squeezes, lifts and does the task; computed once",
        )

    def _steering(self, gui: viser.GuiApi, request: PlanRequest) -> None:
        task = request.asked
        self.object = gui.add_dropdown("Object", self._objects, initial_value=self._label)
        self.upload = gui.add_upload_button(
            "Upload a mesh", color="gray", hint="OBJ, STL, PLY, OFF, GLB, glTF"
        )
        self.unit = gui.add_dropdown("Upload's unit", UNITS, hint="Unit of length in the uploaded file")
        tasks = [*family_names(), SIX]
        self.task = gui.add_dropdown("Task", tasks, initial_value=task.name if task.name in tasks else SIX)
        self.axis = gui.add_dropdown(
            "along / about",
            (USUAL, *AXIS_NAMES),
            initial_value=task.axis if task.axis in AXIS_NAMES else USUAL,
            hint="Signed axis of the task",
        )
        self.task_note = gui.add_html("")
        self.drag = gui.add_checkbox(
            "Drag the task", False, hint="Arrows move and arcs turn the object to its goal"
        )
        self.numbers_box = gui.add_folder("The task as six numbers", expand_by_default=False)
        with self.numbers_box:
            self.numbers = [
                gui.add_slider(name, -1.2, 1.2, 0.05, float(number))
                for name, number in zip(COMPONENTS, task.q.clip(-1.2, 1.2), strict=True)
            ]
        hands = list(dict.fromkeys([*hand_names(), request.hand_name]))
        self.hand = gui.add_dropdown("Hand", hands, initial_value=request.hand_name)
        self.analyser = gui.add_dropdown(
            "Analyser",
            ANALYSERS,
            initial_value=request.analyser,
            hint="rays: the paper's; closure: closes the real hand, slower",
        )

    def _load(self, gui: viser.GuiApi, request: PlanRequest) -> None:
        """Mass, friction, table and boxes, which only the closure analyser uses."""
        mass, table = request.stated_mass, request.table
        stated = mass is not None or table is not None or request.avoid or request.stated_friction != FRICTION
        with gui.add_folder("Load and scene", expand_by_default=bool(stated)):
            self.mass = gui.add_text(
                "mass [kg]",
                "" if mass is None else str(mass),
                hint="Mass of the object; empty for the object's own, else an estimate from its volume",
            )
            self.mass_note = gui.add_html(OWN_MASS)
            self.friction = gui.add_number(
                "friction",
                request.stated_friction,
                min=0.05,
                step=0.05,
                hint="Friction coefficient between hand and object",
            )
            kind = NO_TABLE if table is None else UNDER if table == AUTO else AT_HEIGHT
            self.table = gui.add_dropdown(
                "table", TABLES, initial_value=kind, hint="A table that the hand must not touch"
            )
            self.height = gui.add_number(
                "height [m]",
                float(table) if kind == AT_HEIGHT and table is not None else 0.0,
                step=0.005,
                visible=kind == AT_HEIGHT,
                hint="z of the table in the object's frame; not above the object's lowest point",
            )
            self.avoid = gui.add_text(
                "boxes [m]",
                "\n".join(" ".join(map(str, box)) for box in request.avoid),
                multiline=True,
                hint="Boxes that the hand stays out of, one a line: x0 y0 z0 x1 y1 z1 in the object's frame",
            )

    def _rules(self, gui: viser.GuiApi, request: PlanRequest) -> None:
        """Rules of object and task, and a choice for each part, which :meth:`show_parts` adds."""
        asked = bool(request.hold_on or request.keep_off) or request.rules != FOLLOW
        self.parts_box = gui.add_folder("Parts and rules", expand_by_default=asked)
        self.parts: dict[str, Any] = {}
        with self.parts_box:
            self.rules = gui.add_checkbox(
                "Rules of object and task",
                request.rules == FOLLOW,
                hint="Strike with a hammer held by its handle, leave the inside of a mug free to pour, …",
            )

    def show_parts(self, names: Sequence[str], request: PlanRequest) -> None:
        """Offer the parts of an object, with the choice that a request states for each."""
        for handle in self.parts.values():
            handle.remove()
        self.parts = {}
        stated = {**dict.fromkeys(request.hold_on, HOLD), **dict.fromkeys(request.keep_off, KEEP_OFF)}
        with self.parts_box:
            for name in names[:MOST_PARTS]:
                use = stated.get(name, EITHER)
                self.parts[name] = self.gui.add_dropdown(name, USES, initial_value=use)

    def _search(self, gui: viser.GuiApi, request: PlanRequest) -> None:
        limits = request.settings.thresholds
        with gui.add_folder("Thresholds and search", expand_by_default=False):
            self.estimation = gui.add_slider(
                "good enough",
                0.0,
                6.0,
                0.1,
                limits.estimation,
                hint="Score that an answer must reach: a grip's quality, or TFVADI for rays",
            )
            self.recognition = gui.add_slider(
                "known object", 0.0, 6.0, 0.1, limits.recognition, hint="TFVADI at which an object is known"
            )
            ways = list(dict.fromkeys([ANY, *AXIS_NAMES, request.approaches or ANY]))
            self.approach = gui.add_dropdown(
                "approach",
                ways,
                initial_value=request.approaches or ANY,
                hint="Only planes with this approach axis",
            )
            self.learn = gui.add_checkbox(
                "Learn new objects", request.learn, hint="Teaches a new object to the memory while planning"
            )
            self.verify = gui.add_checkbox(
                "Test in physics",
                request.verify,
                hint="The first answer that holds in simulated physics is the answer; slower",
            )

    def _answers(self, gui: viser.GuiApi) -> None:
        self.answers_note = gui.add_html("")
        self.answers = [
            gui.add_button(f"answer {i + 1}", visible=False, color="gray") for i in range(ALTERNATIVES + 1)
        ]

    def _physics(self, gui: viser.GuiApi) -> None:
        gui.add_html(wrapped(f'<p class="quiet">{TRIAL}</p>'))
        self.simulate = gui.add_button("Simulate this answer", color="blue", disabled=True)
        self.moment = gui.add_slider("Moment", 0.0, 1.0, 0.005, 0.0, visible=False)
        self.replay = gui.add_button("Play the run", visible=False, color="gray")
        self.run_report = gui.add_html("")

    def _layers(self, gui: viser.GuiApi) -> None:
        self.layers: dict[str, Any] = {
            group: gui.add_checkbox(words, group not in HIDDEN) for group, words in GROUPS.items()
        }
        self.glass = gui.add_checkbox("See through the hand", False)
        self.glass_object = gui.add_checkbox("See through the object", False)
        self.camera = gui.add_button("Look from the front again", color="gray")
