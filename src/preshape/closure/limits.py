"""Limits of a finished grip: the heaviest mass that it can hold, and what a weak grip lacks."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress

import numpy as np

from ..hands.hand import Hand
from ..hiis.analyser import Grip
from ..types import FIELD_MASS, GRAVITY, IntArray, told_apart, two_digits
from .candidates import RankedCandidates
from .demand import Demand
from .opening import KEPT_OFF
from .rules import ContactRules, is_rule
from .search import ClosureSearch
from .settings import ClosureSettings

NOTHING = 0.02
"""A grip that holds less than this share of the mass lacks contacts, not strength."""
LOAD, WAY_IN = "the load", "the way in"
"""What refuses candidates, beside obstacles and contact rules by name."""
OBSTACLE = "keep off the obstacle ", "keep off the rest of the scene"
"""Begins of the names of obstacles from files, which are rules to the search."""
NO_RULES = "another part, or --rules none for rules that were not asked for,"
"""What helps against a contact rule."""
OFF_THE_TABLE = "another pose of the object on it (--up), free space (--table none)"
"""What helps against the table."""
HALVINGS = 7
"""Steps of the bisection for the heaviest mass; the result is within 1 % or better."""


def remedy(rules: Sequence[str], best: Grip | None = None) -> str:
    """What would help against the rule that refused most candidates, as the end of a sentence.

    Args:
        rules: The table, boxes, contact rules, load and way in as far as they refused candidates, the
            costliest first.
        best: The best of what was refused; if the hand can execute it, its :func:`shortfall` says what would
            help with the load.

    >>> remedy(["box 2", "the load"])
    '; most are refused because of box 2: moving it or making it smaller (--avoid) would help'
    >>> remedy(["keep off head"])[:60]
    '; most are refused because of the rule to keep off head: ano'
    """
    if not rules or (rules[0] == LOAD and best is not None and not best.refused):
        return ""
    helps, cause = "moving it or making it smaller (--avoid)", rules[0]
    if is_rule(cause):
        helps, cause = NO_RULES, f"the rule to {cause}"
        if rules[0].startswith(OBSTACLE):
            helps, cause = "more room around the object (--obstacle)", rules[0].removeprefix("keep off ")
    if rules[0] == LOAD:
        helps = "a lighter object (--mass), more friction (--friction), another task or another hand"
    elif rules[0] == "the table":
        helps = f"{OFF_THE_TABLE} or a lower table (--table HEIGHT)"
    elif rules[0] == WAY_IN:
        helps = "more approach axes (--approach), if they are restricted, or a smaller hand"
        if best is not None and KEPT_OFF in best.refused:
            helps = f"{NO_RULES}, {helps}"
        if best is not None and ("the table" in best.refused or "a box" in best.refused):
            helps = f"more room around the object (--table, --avoid), {helps}"
    return f"; most are refused because of {cause}: {helps} would help"


def costliest(found: RankedCandidates, blockers: Sequence[str]) -> list[str]:
    """What refused candidates that closed, the costliest first: blockers by name, load or way in.

    Args:
        found: The candidates.
        blockers: Names of the obstacles and contact rules of their tally.
    """
    _, _, clear, balanced, *hits = found.tally.tolist()
    balanced = max(balanced, int(len(found) > 0 and found.score[0] > 0))
    refused = dict(zip(blockers, hits, strict=True))
    refused |= {LOAD: clear - balanced, WAY_IN: balanced}
    return sorted((rule for rule in refused if refused[rule]), key=lambda rule: -refused[rule])


def why_none(found: RankedCandidates, settings: ClosureSettings) -> str:
    """Why none of the candidates became a grip, in one sentence.

    Args:
        found: The candidates.
        settings: Friction, obstacles and rules.
    """
    tried, closed, clear = found.tally[:3].tolist()
    words = f"{tried} candidates were tried"
    if not closed:
        return f"{words}; none of them closed on the object with the thumb and a finger"
    words += f"; {closed} of them closed on the object"
    if clear < closed:
        collide, broken = _refusals(found.tally, settings)
        share = f"{closed - clear if clear else 'all'} of these"
        if collide:
            words += f", {share} in collision with {collide}"
            words += f", or against the rule to {broken}" if broken else ""
        else:
            words += f", {share} against the rule to {broken}"
    if not clear:
        return words
    if not len(found) or found.score[0] <= 0:
        none = "none of the others balances" if clear < closed else "none balances"
        return (
            f"{words}; {none} the load with the planned share of the friction "
            f"({settings.friction_share:g} of {settings.friction:g} = {settings.mu:.2g})"
        )
    return f"{words}; to those that balance the load the hand has no free way in"


def _refusals(tally: IntArray, settings: ClosureSettings) -> tuple[str, str]:
    """The obstacles, and the contact rules, that refused candidates; with numbers if there are several."""
    obstacles = settings.obstacles.names
    names, hits = (*obstacles, *settings.rules.names), tally[4:].tolist()
    said = [f"{name} ({hit})" if len(hits) > 1 else name for name, hit in zip(names, hits, strict=True)]
    first, last = slice(len(obstacles)), slice(len(obstacles), None)
    collide, broken = (compress(said[part], hits[part]) for part in (first, last))
    return " or ".join(collide), " or to ".join(broken)


def rules_cost(tally: IntArray | None, settings: ClosureSettings) -> str:
    """How many hands the table, boxes and contact rules refused, as the end of a sentence; empty if none.

    Args:
        tally: The tally of the search of all planes, if there was one.
        settings: Obstacles and rules.
    """
    obstacles, rules = settings.obstacles.names, settings.rules.names
    if tally is None or not tally[4:].any():
        return ""
    hits = dict(zip((*obstacles, *rules), tally[4:].tolist(), strict=True))
    costs = [f"{hits[name]} are in collision with {name}" for name in obstacles if hits[name]]
    costs += [f"{hits[name]} break the rule to {name}" for name in rules if hits[name]]
    helps = [OFF_THE_TABLE] if "the table" in obstacles and hits["the table"] else []
    helps += ["other boxes (--avoid)"] if any(hits[name] for name in obstacles if name != "the table") else []
    helps += [NO_RULES] if any(hits[name] for name in rules) else []
    return f"; of {tally[1]} hands that closed, {_listed(costs)}: {', or '.join(helps)} may help"


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def nothing_left(rules: ContactRules) -> str:
    """Why there is no candidate: the rules leave no surface to touch."""
    return f"the rules to {' and to '.join(rules.names)} leave no surface to touch; {NO_RULES} would help"


def strongest_press(grip: Grip, hand: Hand) -> float:
    """Largest sum of normal forces that the motors' torques allow the grip [N]."""
    drive = grip.torques @ hand.rates(grip.grasp)
    strain = float((np.abs(drive) / hand.torque_limits).max())
    return grip.press / max(strain, 1e-9)


def heaviest_mass(search: ClosureSearch, grip: Grip, demand: Demand) -> float:
    """Heaviest mass for which the grip would still be good enough for the task [kg].

    The grip is good enough if the strongest press that the settings and the motors' torques allow balances
    the load: strength · press / weight ≥ 1. The joints limit the press, so a heavier object takes a larger
    share of it and the strength falls. Therefore the mass is found by bisection.

    Args:
        search: The search that found the grip.
        grip: The grip.
        demand: What the task asks at the planned mass.
    """
    settings, hand = search.settings, search.hand
    limit = strongest_press(grip, hand)
    hold = grip.hold_margin * settings.weight / grip.press

    def margin(mass: float) -> float:
        heavier = max(1.0, mass / FIELD_MASS)
        carried = min(_middling(settings) * heavier, limit)
        task = search.strength_of(grip, demand, mass * GRAVITY / carried) / demand.load
        return min(task, hold) * min(settings.press_most * heavier, limit) / (mass * GRAVITY)

    low, high = 0.0, hold * limit / GRAVITY
    if grip.quality >= 3.0 or min(grip.task_margin, grip.hold_margin) >= 1.0:
        low = settings.planned_mass
    else:  # the squeeze that was found is not good enough for this mass
        high = min(high, settings.planned_mass)
    for _ in range(HALVINGS):
        if high <= low:
            break
        middle = high / 2 if low == 0.0 else float(np.sqrt(low * high))
        low, high = (middle, high) if margin(middle) >= 1.0 else (low, middle)
    return low


def _middling(settings: ClosureSettings) -> float:
    """Press that carries the weight of a 0.1 kg object in the ranking [N]."""
    return 0.5 * (settings.press_least + settings.press_most)


def shortfall(search: ClosureSearch, grip: Grip, demand: Demand) -> str:
    """What a grip lacks and what would help, in one sentence; empty if the grip is good enough.

    Args:
        search: The search that found the grip.
        grip: The best grip that was found.
        demand: What the task asks at the planned mass.
    """
    if grip.refused:
        return f"the best of these balances {two_digits(grip.task_margin)} times the load, but {grip.refused}"
    settings, margin = search.settings, min(grip.task_margin, grip.hold_margin)
    mass, most = settings.planned_mass, heaviest_mass(search, grip, demand)
    if most >= mass:
        return (
            f"the best grip balances {two_digits(margin)} times the load: a lower threshold would accept it"
        )
    share = f"{settings.friction_share:g} of the friction {settings.friction:g}"
    if most < NOTHING * mass:
        return (
            f"the contacts of the best grip cannot balance {mass:.3g} kg with the planned {share}; a "
            "lighter object (--mass), more friction (--friction), another task or another hand would help"
        )
    limit = strongest_press(grip, search.hand)
    bound = "the motors' torques allow" if limit <= settings.strongest else "at this mass the planner allows"
    held, asked = told_apart(most, mass)
    return (
        f"the best grip would hold {held} kg, and {asked} kg is asked: {bound} a press of "
        f"{min(limit, settings.strongest):.0f} N; a lighter object (--mass), more friction (--friction) or a "
        "stronger hand would help"
    )
