"""The widgets of a browser's panel: made here, wired by :mod:`.session`."""

from __future__ import annotations

from importlib import resources
from typing import TYPE_CHECKING, Any

from ..hands.load import hand_names
from ..hiis.planes import AXIS_NAMES
from ..objects.library import names as object_names
from ..tasks import family_names, parse_task
from ..tasks.task import COMPONENTS
from ..viewer.draw import GROUPS, HIDDEN
from ..viewer.readings import wrapped
from .tuning import Tuning
from .worker import ALTERNATIVES, Order

if TYPE_CHECKING:
    import viser

SIX = "six numbers"
ANY = "any"
USUAL = "usual"
UNITS = ("m", "cm", "mm", "in")
OFFERS = 3
ACCEPT, REJECT = VERDICTS = ("Accept", "Reject")
TRIAL = (
    "The hand grasps and squeezes in simulated physics (MuJoCo), then the object is pushed from six sides. "
    "Friction and mass are those of the Plan tab. A scan takes up to two minutes the first time."
)


class Panel:
    """All widgets of one browser.

    Args:
        gui: the browser's panel.
        order: what the widgets show at first.
        memory: where the memory is, for people.
    """

    def __init__(self, gui: viser.GuiApi, order: Order, memory: str) -> None:
        self.gui = gui
        gui.add_html(f"<style>{(resources.files('preshape.viewer') / 'web' / 'app.css').read_text()}</style>")
        self.headline = gui.add_html("")
        self.progress = gui.add_progress_bar(0, visible=False, animated=True)
        self.cancel = gui.add_button(
            "Cancel", visible=False, color="gray", hint="Stop; nothing learnt is lost"
        )
        self._critic(gui)
        self._motion(gui)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Plan"):
            self._steering(gui, order)
        with tabs.add_tab("Why"):
            self.why = gui.add_html("")
        with tabs.add_tab("Answers"):
            self._answers(gui)
        with tabs.add_tab("Physics"):
            self._physics(gui)
        with tabs.add_tab("Tune"):
            self.tuning = Tuning(gui)
        with tabs.add_tab("Memory"):
            self.memory = gui.add_html("")
            self.memory_again = gui.add_button("Read again", color="gray")
            style = "font-size:11px;color:#59626D;overflow-wrap:anywhere;padding:0 10px"
            gui.add_html(f'<div style="{style}">{memory}</div>')
        with tabs.add_tab("Show"):
            self._layers(gui)

    def _critic(self, gui: viser.GuiApi) -> None:
        """What the external critic can say to an answer; shown when there is something to say."""
        self.offers = [gui.add_button(f"offer {i}", visible=False, color="orange") for i in range(OFFERS)]
        self.reset = gui.add_button(
            "Reset the deadlock", visible=False, color="orange", hint="Then ask for another task or object"
        )
        self.verdict = gui.add_button_group("Your verdict", VERDICTS, visible=False)

    def _motion(self, gui: viser.GuiApi) -> None:
        marks = ((0.0, "away"), (1.0, "open"), (2.0, "closed"), (3.0, "squeeze"))
        self.slider = gui.add_slider("Move hand", 0.0, 3.0, 0.05, 3.0, marks=marks, visible=False)
        self.play = gui.add_button("Play the grasp", visible=False, color="gray")

    def _steering(self, gui: viser.GuiApi, order: Order) -> None:
        library = list(object_names())
        first = order.source if order.source in library else library[0]
        self.thing = gui.add_dropdown("Object", library, initial_value=first)
        self.upload = gui.add_upload_button(
            "Upload a mesh", color="gray", hint="OBJ, STL, PLY, OFF, GLB, glTF"
        )
        self.unit = gui.add_dropdown("Upload's unit", UNITS, hint="Of the uploaded file")
        tasks = [*family_names(), SIX]
        named = order.task.partition(":")[0]
        self.task = gui.add_dropdown("Task", tasks, initial_value=named if named in tasks else SIX)
        axis = order.task.partition(":")[2]
        self.axis = gui.add_dropdown(
            "along / about",
            (USUAL, *AXIS_NAMES),
            initial_value=axis if axis in AXIS_NAMES else USUAL,
            hint="The task's signed axis",
        )
        self.task_note = gui.add_html("")
        self.drag = gui.add_checkbox(
            "Drag the task", False, hint="Arrows move, arcs turn: to where the object is to go"
        )
        self.numbers_box = gui.add_folder("The task as six numbers", expand_by_default=False)
        with self.numbers_box:
            self.numbers = [
                gui.add_slider(name, -1.2, 1.2, 0.05, float(number))
                for name, number in zip(COMPONENTS, parse_task(order.task).q.clip(-1.2, 1.2), strict=True)
            ]
        hands = list(hand_names())
        hands += [order.hand] if order.hand not in hands else []  # a hand of the person's own
        self.hand = gui.add_dropdown("Hand", hands, initial_value=order.hand)
        self.analyser = gui.add_dropdown(
            "Analyser",
            ("rays", "closure"),
            initial_value=order.analyser,
            hint="rays: the paper's; closure: closes the real hand, slower",
        )
        with gui.add_folder("Thresholds and load", expand_by_default=False):
            self.estimation = gui.add_slider(
                "enough match", 0.0, 6.0, 0.1, order.estimation, hint="TFVADI that an answer must reach"
            )
            self.recognition = gui.add_slider(
                "known object", 0.0, 6.0, 0.1, order.recognition, hint="TFVADI at which an object is known"
            )
            self.approach = gui.add_dropdown(
                "approach", (ANY, *AXIS_NAMES), hint="Only planes that come this way"
            )
            self.friction = gui.add_slider("friction", 0.1, 1.5, 0.05, order.friction, hint="closure only")
            self.mass = gui.add_slider("mass [kg]", 0.02, 2.0, 0.02, order.mass, hint="closure only")
        self.run = gui.add_button("Plan", color="blue", hint="Run modes 0 to 3")
        self.teach = gui.add_button(
            "Teach this object and task", color="gray", hint="Explore and learn, mode 3"
        )

    def _answers(self, gui: viser.GuiApi) -> None:
        self.answers_note = gui.add_html("")
        self.answers = [
            gui.add_button(f"answer {i + 1}", visible=False, color="gray") for i in range(ALTERNATIVES + 1)
        ]

    def _physics(self, gui: viser.GuiApi) -> None:
        gui.add_html(wrapped(f'<p class="quiet">{TRIAL}</p>'))
        self.simulate = gui.add_button("Simulate this answer", color="blue", disabled=True)
        self.run_words = gui.add_html("")
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
