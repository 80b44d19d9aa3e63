"""Controllers and analysers of a request: the paper's over its rays, and over the hand that closes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from ..closure.contact_places import ContactPlaces
from ..closure.rules import ContactRules
from ..closure.settings import FRICTION_SHARE, ClosureSettings
from ..hands.hand import Hand
from ..hiis.analyser import HandLayout
from ..hiis.controller import Controller
from ..hiis.decision import Settings
from ..hiis.virtual_grasp import RayAnalyser
from ..memory import Memory
from ..objects.library import load_library_object
from ..objects.mass import object_mass
from ..objects.mesh import TriangleMesh
from ..types import Array, Experience
from .request import PlanRequest

if TYPE_CHECKING:
    from ..closure.analyser import ClosureAnalyser

CLOSURE_SUFFIX = "+closure"
"""Suffix of the hand's name for lessons of the closure analyser; it separates them from those of rays."""


def layout_of(hand: Hand) -> HandLayout:
    """The dimensions of a hand that the analysers need."""
    return HandLayout(
        name=hand.name, u=hand.u, finger_pitch=hand.finger_pitch, fingertip_width=hand.fingertip_width
    )


def ray_controller(
    memory: Memory, layout: HandLayout, request: PlanRequest, rules: ContactRules, scene: str
) -> Controller:
    """The paper's controller over its own analyser, which obeys the rules about contacts.

    Args:
        memory: The memory.
        layout: The hand.
        request: The request.
        rules: Where contacts may be; the first lesson, with the cube, has none.
        scene: The scene as text (:meth:`PlanRequest.scene`).
    """
    s, prepare = request.settings, None
    plain = partial(RayAnalyser, layout=layout, coefficients=s.coefficients, sets=s.sets)
    if rules:
        prepare = partial(plain, rules=ContactPlaces(rules))
    return Controller(
        memory,
        layout,
        settings=s,
        prepare=prepare or plain,
        prepare_seed=plain,
        scene=scene,
        may_store=request.learn,
    )


def closure_analyser(request: PlanRequest, hand: Hand, mesh: TriangleMesh) -> ClosureAnalyser:
    """The closure analyser of a request without a memory: it needs no first lesson and recalls nothing.

    Args:
        request: The request.
        hand: Its hand, loaded.
        mesh: Its object, loaded [m].
    """
    from ..closure.analyser import ClosureAnalyser

    settings = request.settings
    return ClosureAnalyser(
        mesh,
        hand,
        layout_of(hand),
        settings=request.closure(mesh, object_mass(mesh, request.stated_mass).kg),
        coefficients=settings.coefficients,
        sets=settings.sets,
        gravity=request.task_gravity(mesh),
        seed=settings.seed,
    )


def closure_controller(
    memory: Memory,
    hand: Hand,
    *,
    settings: Settings,
    closure: ClosureSettings,
    gravity: Array | Sequence[float],
    scene: str = "",
    may_store: bool = True,
) -> Controller:
    """The paper's controller over the closure analyser.

    Args:
        memory: The memory.
        hand: The hand.
        settings: Meta control's settings.
        closure: Friction, load and size of the search.
        gravity: (3,) unit direction of gravity in the mesh frame; zeros mean none.
        scene: The scene as text (:meth:`PlanRequest.scene`).
        may_store: Whether the first lesson may be stored; see :class:`Controller`.
    """
    from ..closure.analyser import ClosureAnalyser

    layout = replace(layout_of(hand), name=hand.name + CLOSURE_SUFFIX, model=hand.model_hash())

    def known() -> Sequence[Experience]:
        return controller.experiences

    def prepare(mesh: TriangleMesh) -> ClosureAnalyser:
        return ClosureAnalyser(
            mesh,
            hand,
            layout,
            settings=closure,
            coefficients=settings.coefficients,
            sets=settings.sets,
            gravity=gravity,
            seed=settings.seed,
            known=known,
            scene=scene,
        )

    def prepare_seed(mesh: TriangleMesh) -> ClosureAnalyser:
        # The 48 tasks of the cube only teach the planes, not the best grips: a small search is enough, of
        # wraps as well.
        quick = ClosureSettings(
            threads=closure.threads,
            device=closure.device,
            everywhere=400,
            wraps=480,
            elite=8,
            rounds=1,
            finished=1,
            persistence=0,
            bold_share=FRICTION_SHARE,
        )
        return ClosureAnalyser(
            mesh, hand, layout, settings=quick, sets=settings.sets, seed=settings.seed, gravity=gravity
        )

    controller = Controller(
        memory,
        layout,
        settings=settings,
        prepare=prepare,
        prepare_seed=prepare_seed,
        seed_object=load_library_object("cube"),
        kind="shape",
        scene=scene,
        may_store=may_store,
    )
    return controller
