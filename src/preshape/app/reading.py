"""The plan in one browser: its answers, the shown answer, and the texts about them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ..files import dumps
from ..hands.load import recorded_hand
from ..pictures import Document, document_html
from ..report.plain import html_text as escape
from ..viewer import readings, words
from .panel import OWN_MASS, Panel
from .stage import Stage

STAGES = 3.0
"""Largest value of the hand's slider."""


class Reading:
    """One browser's plan.

    Attributes:
        document: The plan; ``None`` before there is one.
        offers: Tasks that fit the object, if the requested one does not (mode 2).

    Args:
        panel: The panel that shows the readings.
        stage: The scene that shows the answer.
    """

    def __init__(self, panel: Panel, stage: Stage) -> None:
        self._panel, self._stage = panel, stage
        self.document: Document | None = None
        self.offers: list[str] = []
        self._answers: list[Document] = []
        self._rays: list[Any] = []
        self._shown = 0
        self._rejected: set[int] = set()

    def forget(self) -> None:
        """Drop the plan and show the object alone."""
        p = self._panel
        self.document, self._answers, self._rays, self._rejected = None, [], [], set()
        self._shown, self.offers = 0, []
        p.why.content = p.answers_note.content = ""
        p.mass_note.content = OWN_MASS
        for handle in (*p.offers, *p.answers, p.verdict, p.slider, p.play, p.film):
            handle.visible = False
        p.simulate.disabled = True
        self._stage.show(None, None)

    def take(self, document: Document, rays: list[Any]) -> None:
        """Take a new plan and show its answer, or take a later version of it with more answers."""
        first = self.document is None
        self.document, self._answers, self._rays = document, words.answers_of(document), rays
        mass = words.mass_words(document)
        self._panel.mass_note.content = readings.wrapped(f'<p class="quiet">Planned with {escape(mass)}.</p>')
        if first:
            self.show(0)
        else:
            self._list()

    def restore(self, document: Document, rays: list[Any], shown: int, rejected: Iterable[int]) -> None:
        """Show a plan as it was: with its rejected answers, and the answer that was shown."""
        self.take(document, rays)
        self._rejected = set(rejected)
        self.show(shown)
        if self.document is not None and self._answers and len(self._rejected) == len(self._answers):
            self._panel.verdict.visible = False

    @property
    def state(self) -> tuple[list[Any], int, frozenset[int]]:
        """The rays of each answer, the index of the shown one, and the indices of the rejected ones."""
        return self._rays, self._shown, frozenset(self._rejected)

    def show(self, index: int) -> None:
        """Show one of the answers; if there are none, the object alone."""
        document, p = self.document, self._panel
        if document is None:
            return
        answer = self._answers[index] if index < len(self._answers) else None
        self._shown = index
        p.slider.value = STAGES
        rays = self._rays[index] if index < len(self._rays) else None
        self._stage.show(document, answer, rays=rays, share=1.0)
        self.headline()
        grasped = answer is not None and answer["hand"]["grasp"] is not None
        p.simulate.disabled = not grasped
        p.film.visible = grasped
        if answer is not None:
            table = (answer.get("scene") or {}).get("table")
            p.film.label = "Play it held in physics" if table is None else "Play the whole job"
        parts = [readings.transitions(document)]
        if answer is not None:
            parts = readings.answer_parts(document, self._answers, index)
        p.why.content = readings.wrapped(*parts, readings.glossary())
        p.slider.visible = p.play.visible = self._stage.motion is not None
        p.verdict.visible = self._accepted
        self._list()

    @property
    def _accepted(self) -> bool:
        """Whether the answers are good enough; otherwise the best grasp that was tried is shown."""
        return bool(self._answers) and self._answers[0].get("status") == "answer"

    @property
    def answer(self) -> Document | None:
        """The answer that is shown."""
        return self._answers[self._shown] if self._shown < len(self._answers) else None

    def headline(self) -> None:
        """Show the plan's result as the headline."""
        if self.document is not None:
            self._panel.headline.content = readings.wrapped(readings.headline(self.document))

    def pick(self, index: int) -> str:
        """Show the best answer on a plane.

        Returns:
            A sentence if there is no answer on that plane, otherwise an empty text.
        """
        left = [i for i, a in enumerate(self._answers) if a["plane"] == index and i not in self._rejected]
        if left:
            self.show(left[0])
            return ""
        if self.document is None:
            return "Press Plan; then a click on a plane shows the best answer on it."
        return "None of the answers lies on this plane: no grasp on it is good enough for the task."

    def reject(self) -> bool:
        """Remove the shown answer from the ranking and show the next; returns False if none is left."""
        self._rejected.add(self._shown)
        left = [i for i in range(len(self._answers)) if i not in self._rejected]
        if left:
            self.show(left[0])
        else:
            self._list()
            self._panel.verdict.visible = False
        return bool(left)

    def title(self) -> str:
        """File name of the shown answer, without its ending."""
        assert self.document is not None
        return f"{self.document['object']['name']}-{self.document['task']['name']}".replace(":", "")

    def files(self) -> dict[str, bytes]:
        """The shown answer as ``json``, and its page as ``html``."""
        mesh = self._stage.mesh
        assert mesh is not None
        answer = dict(self._answers[self._shown])
        page = document_html(mesh, recorded_hand(answer["hand"]), answer)
        return {"json": (dumps(answer) + "\n").encode(), "html": page.encode()}

    def share(self) -> float:
        """Position of the slider: fraction 0..1 of the hand's motion."""
        return float(self._panel.slider.value) / STAGES

    def _list(self) -> None:
        """Show the ranking, and the offered tasks that fit the object."""
        document, p = self.document, self._panel
        assert document is not None
        lines = words.answers_words(self._answers)
        for i, button in enumerate(p.answers):
            button.visible = i < len(self._answers) and i not in self._rejected
            if i < len(self._answers):
                button.label = f"{i + 1} · {lines[i]}"
                button.color = "blue" if i == self._shown else "gray"
        note = "The answer, then the alternatives by score; press one to see it."
        if not self._accepted:
            note = (
                "No answer is good enough; this is the best that was tried."
                if self._answers
                else "No answer."
            )
        p.answers_note.content = readings.wrapped(f'<p class="quiet">{note}</p>')
        self.offers = [str(offer["task"]) for offer in document.get("offers", [])]
        for i, button in enumerate(p.offers):
            button.visible = i < len(self.offers)
            if i < len(self.offers):
                match = document["offers"][i]["tfvadi"]
                button.label = f"Try {self.offers[i]} instead (match {match:.2f})"
