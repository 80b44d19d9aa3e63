"""What one browser reads of a plan: mode, reasons, bars, the ranking, and which answer is shown."""

from __future__ import annotations

from typing import Any

from ..hands.load import load_hand
from ..planning.document import dumps
from ..viewer import readings
from .panel import Panel
from .scenes import Document, document_html
from .stage import Stage

STAGES = 3.0
"""Largest value of the hand's slider."""


class Reading:
    """One browser's plan.

    Attributes:
        document: the plan; ``None`` before there is one.
        offers: tasks that fit in place of the one asked for (mode 2).

    Args:
        panel: where it is read.
        stage: where it is seen.
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
        """No plan: the object alone."""
        p = self._panel
        self.document, self._answers, self._rays, self._rejected = None, [], [], set()
        self._shown, self.offers = 0, []
        p.why.content = p.answers_note.content = ""
        for handle in (*p.offers, *p.answers, p.verdict, p.slider, p.play):
            handle.visible = False
        p.simulate.disabled = True
        self._stage.show(None, None)

    def take(self, document: Document, rays: list[Any]) -> None:
        """A plan has come, or more of it; the first time its answer is shown."""
        first = self.document is None
        self.document, self._answers, self._rays = document, readings.answers_of(document), rays
        if first:
            self.show(0)
        else:
            self._list()

    def show(self, index: int) -> None:
        """Show one of the answers, or that there is none."""
        document, p = self.document, self._panel
        if document is None:
            return
        answer = self._answers[index] if index < len(self._answers) else None
        self._shown = index
        p.slider.value = STAGES
        rays = self._rays[index] if index < len(self._rays) else None
        friction = float(p.friction.value)
        self._stage.show(document, answer, friction=friction, rays=rays, share=1.0)
        self.headline()
        p.simulate.disabled = answer is None or answer["hand"]["grasp"] is None
        words = [readings.transitions(document), readings.glossary()]
        if answer is not None:
            words[:0] = [
                readings.why(document, self._answers, index),
                readings.facts(document, answer),
                readings.bars(document, answer),
            ]
        p.why.content = readings.wrapped(*words)
        p.slider.visible = p.play.visible = self._stage.motion is not None
        p.verdict.visible = answer is not None
        self._list()

    @property
    def answer(self) -> Document | None:
        """The answer that is shown."""
        return self._answers[self._shown] if self._shown < len(self._answers) else None

    def headline(self) -> None:
        """Say how the plan ended."""
        if self.document is not None:
            self._panel.headline.content = readings.wrapped(readings.headline(self.document))

    def pick(self, index: int) -> str:
        """Show the best answer on a plane; a sentence where there is none."""
        kept = [i for i, a in enumerate(self._answers) if a["plane"] == index and i not in self._rejected]
        if kept:
            self.show(kept[0])
            return ""
        if self.document is None:
            return "Press Plan; then a click on a plane shows the best answer on it."
        return "None of the answers lies on this plane: what it gives matches the task too little."

    def reject(self) -> bool:
        """Take the shown answer out of the ranking and show the next best; False where none is left."""
        self._rejected.add(self._shown)
        left = [i for i in range(len(self._answers)) if i not in self._rejected]
        if left:
            self.show(left[0])
        else:
            self._list()
            self._panel.verdict.visible = False
        return bool(left)

    def title(self) -> str:
        """Name of the files of the shown answer."""
        assert self.document is not None
        return f"{self.document['object']['name']}-{self.document['task']['name']}".replace(":", "")

    def files(self) -> dict[str, bytes]:
        """The shown answer as ``json``, and its page as ``html``."""
        mesh = self._stage.mesh
        assert mesh is not None
        answer = dict(self._answers[self._shown])
        page = document_html(mesh, load_hand(answer["hand"]["name"]), answer)
        return {"json": (dumps(answer) + "\n").encode(), "html": page.encode()}

    def share(self) -> float:
        """How far the hand is on its way, 0..1."""
        return float(self._panel.slider.value) / STAGES

    def _list(self) -> None:
        """The ranking, and what else fits."""
        document, p = self.document, self._panel
        assert document is not None
        for i, button in enumerate(p.answers):
            button.visible = i < len(self._answers) and i not in self._rejected
            if i < len(self._answers):
                button.label = f"{i + 1} · {readings.answer_words(self._answers[i])}"
                button.color = "blue" if i == self._shown else "gray"
        note = (
            "The answer, then other ways, best first; press one to see it."
            if self._answers
            else "No answer yet."
        )
        p.answers_note.content = readings.wrapped(f'<p class="quiet">{note}</p>')
        self.offers = [str(offer["task"]) for offer in document.get("offers", [])]
        for i, button in enumerate(p.offers):
            button.visible = i < len(self.offers)
            if i < len(self.offers):
                match = document["offers"][i]["tfvadi"]
                button.label = f"Try {self.offers[i]} instead (match {match:.2f})"
