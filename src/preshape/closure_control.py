"""The paper's controller over the closure analyser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from .closure.analyser import ClosureAnalyser
from .closure.settings import ClosureSettings
from .hands.hand import Hand
from .hiis.analyser import HandLayout
from .hiis.controller import Controller
from .hiis.decision import Settings
from .memory import Memory
from .objects.mesh import TriangleMesh
from .types import Array, Experience

SUFFIX = "+closure"
"""What a hand closed for real has met is kept apart from what rays have found for it."""


def closure_controller(
    memory: Memory,
    hand: Hand,
    layout: HandLayout,
    *,
    settings: Settings,
    closure: ClosureSettings,
    gravity: Array | Sequence[float],
) -> Controller:
    """A controller whose performance element closes the real hand.

    Args:
        memory: what was learnt so far.
        hand: the hand.
        layout: what the controller knows of it.
        settings: meta control's.
        closure: friction, load, size of the search.
        gravity: (3,) its unit direction in the mesh frame, zeros for none.
    """
    own = replace(layout, name=layout.name + SUFFIX)

    def known() -> Sequence[Experience]:
        return controller.experiences

    def prepare(mesh: TriangleMesh) -> ClosureAnalyser:
        return ClosureAnalyser(
            mesh,
            hand,
            own,
            settings=closure,
            coefficients=settings.coefficients,
            sets=settings.sets,
            gravity=gravity,
            seed=settings.seed,
            known=known,
        )

    def prepare_seed(mesh: TriangleMesh) -> ClosureAnalyser:
        # The cube's 48 tasks: a first idea of planes, not the best grips.
        quick = replace(
            ClosureSettings(threads=closure.threads, device=closure.device),
            everywhere=400,
            elite=8,
            rounds=1,
            finished=1,
            persistence=0,
        )
        return ClosureAnalyser(
            mesh, hand, own, settings=quick, sets=settings.sets, seed=settings.seed, gravity=gravity
        )

    controller = Controller(
        memory, own, settings=settings, prepare=prepare, prepare_seed=prepare_seed, kind="shape"
    )
    return controller
