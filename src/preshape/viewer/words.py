"""A plan's results in words, from its document; the terminal, the panel, the page and the picture use them.

A grip of a real hand is described by what decided it: quality, margins, press, load and way in.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import count
from typing import Any

from ..objects.mass import ObjectMass
from ..tasks.task import COMPONENTS, ROTATION_ABSENT, TRANSLATION_ABSENT
from ..types import FIELD_MASS, FRICTION, MODES, STEPS, quality_text, two_digits

Document = dict[str, Any]

QUALITY = (
    "quality is 6 (1 - 2^-m) for the smaller margin m at the strongest press that hand and planner allow: "
    "3 at m = 1, 4.5 at 2, and less for a soft grip; the margins stated are those of the press stated"
)
"""How quality and margins of a grip are related."""
TURNED = 5.0
"""Angle between how an object is modelled and how it rests above which it is stated [degrees]."""
ASIDE = 20.0
"""Angle between way in and approach axis above which both are stated [degrees]."""
STEEP = 0.7
"""Cosine between up and a way in above which the hand comes from above or below."""
_RESULTS = {
    "answer": ("✓", "good", "Grasp found"),
    "task_correction": ("?", "warn", "The known object does not fit this task"),
    "deadlock": ("✕", "bad", "Deadlock: no grasp is good enough"),
    "no_grasp": ("✕", "bad", "No grasp found"),
}


def answers_of(document: Document, *, best: bool = True) -> list[Document]:
    """Every answer of a plan that has a grasp: the plan's own, then the alternatives.

    Args:
        document: The plan.
        best: Whether a plan without an answer gives the best grasp that was found, if any.
    """
    first = [document] if document.get("plane") else []
    found = [*first, *document.get("alternatives", [])]
    return found or ([document["best"]] if best and document.get("best") else [])


def result(document: Document) -> tuple[str, str, str]:
    """Sign, kind (``good``, ``warn`` or ``bad``) and words of a plan's result.

    The words name the motion that a virtual grasp does not give or opposes, and a test in physics that
    failed.
    """
    status = str(document["status"])
    sign, kind, title = _RESULTS.get(status, ("", "warn", status))
    verified = document.get("verified")
    if status == "answer" and verified and not verified["held"]:
        return "✕", "bad", "No answer held in physics"
    if document.get("missing_motion"):
        return "!", "warn", f"{title}, but it {missing_words(document)}"
    if none_reached(document):
        title = "The arm reaches no answer"
    shown = "; the best try is shown" if document.get("best") and not document.get("plane") else ""
    return sign, kind, title + shown


def none_reached(document: Document) -> bool:
    """Whether a plan has no answer because its arm serves none."""
    arm = document.get("arm") or {"tested": 0}
    return document["status"] == "deadlock" and bool(arm["tested"]) and arm["tested"] == len(arm["refused"])


def missing_words(document: Document) -> str:
    """What an answer makes of the task's largest components, if it matches none of them.

    >>> lift = {"missing_motion": "Tz", "task": {"q": [0.1, 0.1, 1, 0, 0, 0]}}
    >>> missing_words({**lift, "net_wrench": [0, 0, -1.16, 0, 0, 0]})
    'opposes Tz'
    """
    parts: dict[str, list[str]] = {}
    numbers = zip(COMPONENTS, document["task"]["q"], document["net_wrench"], strict=True)
    for name, asked, given in numbers:
        if name in document["missing_motion"].split(" and "):
            parts.setdefault(mismatch(name, asked, given), []).append(name)
    return " and ".join(f"{verb} {' and '.join(names)}" for verb, names in parts.items())


def mismatch(name: str, asked: float, given: float) -> str:
    """How a component of a net wrench fails the task, as a verb that the component's name follows.

    >>> mismatch("Tz", 1.0, -1.16), mismatch("Tz", 1.0, 0.05), mismatch("Rx", 0.8, 0.3)
    ('opposes', 'gives nothing along', 'gives too little about')
    """
    along = "along" if name[0] == "T" else "about"
    if abs(given) <= (TRANSLATION_ABSENT if name[0] == "T" else ROTATION_ABSENT):
        return f"gives nothing {along}"
    if asked * given < 0:
        return "opposes"
    return f"gives too {'little' if abs(given) < abs(asked) else 'much'} {along}"


def mode_words(mode: int, known: bool = True) -> str:
    """An execution mode in plain words, with the paper's number.

    Args:
        mode: The mode, 0..3.
        known: Whether the memory holds an experience of the object.

    >>> mode_words(0), mode_words(0, known=False)
    ('known (mode 0)', 'estimated (mode 0)')
    """
    return f"{MODES[mode] if mode or known else 'estimated'} (mode {mode})"


def plan_mode(document: Document) -> str:
    """The mode in which a plan ended, in plain words; a plan of an older program does not say ``known``."""
    return mode_words(int(document["mode"]), document.get("known", True))


def correction_words(document: Document) -> tuple[str, ...]:
    """What to do after a task correction, in one sentence; empty after any other result."""
    if document["status"] != "task_correction":
        return ()
    if document["mode"] == 3:
        return ("All planes were searched: ask for another task, or for this one with another load.",)
    return (
        "Not all planes were searched: ask for another task, or explore and learn this one "
        "(preshape learn OBJECT --task TASK).",
    )


def step_words(transition: Document) -> str:
    """One step of the search: what was done, the paper's mode, and its outcome."""
    mode = int(transition["mode"])
    return f"{STEPS[mode]} (mode {mode}), {transition['outcome']}"


def way_in(answer: Document) -> list[float]:
    """(3,) Unit vector along which the hand comes in; plans of version 1 state it only for grips."""
    grip = answer.get("grip")
    way = answer.get("way_in") or (grip["approach"] if grip else answer["approach_axis"])
    return [float(x) for x in way]


def way_in_words(answer: Document) -> str:
    """The way in: the nearest coordinate axis, the angle to it, and the plane's axis if it is another one.

    >>> way_in_words({"way_in": [0.0, 0.2, -0.98], "approach_axis": [0.0, 0.0, -1.0]})
    'comes in 12° off the -Z axis'
    """
    way = way_in(answer)
    axis = axis_words(way)
    off = _angle(way, [float(letter == axis[1]) * (1 if axis[0] == "+" else -1) for letter in "XYZ"])
    words = f"comes in {off:.0f}° off the {axis} axis" if off >= 1.0 else f"comes in along {axis}"
    aside = _angle(way, answer["approach_axis"])
    if aside > ASIDE and axis_words(answer["approach_axis"]) != axis:
        words += f", {aside:.0f}° off the plane's approach axis {axis_words(answer['approach_axis'])}"
    return words


def plane_words(answer: Document) -> str:
    """The axes of an answer's plane in words."""
    opposition = axis_words(answer["opposition_axis"])[1]
    return f"approach {axis_words(answer['approach_axis'])}, opposition {opposition}"


def thumb_side(answer: Document) -> str:
    """The side of the object on which the thumb stands, as a signed axis."""
    return axis_words([-x if answer["flip"] else x for x in answer["opposition_axis"]])


def thumb_words(answer: Document) -> str:
    """On which side of the object the thumb stands."""
    return f"thumb on the {thumb_side(answer)} side"


def place_words(answer: Document) -> str:
    """What tells an answer from others of its plane: the aim of a virtual grasp, the palm of a grip."""
    words = [plane_words(answer), thumb_words(answer)]
    grasp = answer["hand"]["grasp"]
    if answer.get("grip") and grasp:
        palm = ", ".join(f"{1000 * x:.0f}" for x in grasp["palm_pose"][:3])
        return ", ".join([*words, way_in_words(answer), f"palm at {palm} mm"])
    return ", ".join([*words, f"approach value {answer['approach_value']:+.2f}"])


def axis_words(axis: Sequence[float]) -> str:
    """The signed coordinate axis nearest to a vector, such as ``+X``."""
    i = max(range(3), key=lambda k: abs(axis[k]))
    return ("+" if axis[i] > 0 else "-") + "XYZ"[i]


def press(answer: Document) -> float:
    """Sum of the normal forces of a grip [N]."""
    forces, contacts = answer["grip"]["forces"], answer["contacts"]
    return sum(_dot(force, c["normal_in"]) for force, c in zip(forces, contacts, strict=True))


def odds_words(answer: Document) -> str:
    """How probably a grip picks its object up from the table; empty without a table."""
    odds = answer["grip"].get("pick_probability")
    if odds is None:
        return ""
    share = "over 0.99" if odds > 0.99 else f"{odds:.2f}"
    return f"{share} of grips like this one pick their object up in simulated physics"


def figures(answer: Document) -> list[tuple[str, str, str]]:
    """Name, value and unit of the few numbers that decided an answer."""
    grip = answer.get("grip")
    if grip:
        return [
            ("quality", quality_text(grip["quality"]), "of 6"),
            ("task margin", two_digits(grip["task_margin"]), ""),
            ("hold margin", two_digits(grip["hold_margin"]), ""),
            ("press", f"{press(answer):.0f}", "N"),
        ]
    indices = [("TFVADI", f"{answer['tfvadi']:.2f}"), ("stability", f"{answer['stability']}")]
    indices.append(("manipulability", f"{answer['manipulability']}"))
    return [(*index, "of 6") for index in indices]


def score_name(answer: Document) -> str:
    """Name of the number that the critic judges: quality of a grip, match of a virtual grasp."""
    return "quality" if answer.get("grip") else "match"


def score(answer: Document) -> float:
    """The number that the critic judges, 0..6."""
    grip = answer.get("grip")
    return float(grip["quality"] if grip else answer["tfvadi"])


def fingers_words(answer: Document) -> str:
    """Names of the fingers in contact, with their numbers of links; their number without names."""
    names = [str(c["finger"]) for c in answer["contacts"]]
    words = {"palm": "places"}
    counted = [
        name if names.count(name) == 1 else f"{name} ({names.count(name)} {words.get(name, 'links')})"
        for name in dict.fromkeys(names)
    ]
    return ", ".join(counted) or str(answer["fingers"])


def type_words(answer: Document) -> str:
    """Type of a grip in the taxonomy's words; empty for a virtual grasp or an older plan."""
    kind = (answer.get("grip") or {}).get("type")
    return f"{kind['name']} ({kind['power']}, {kind['opposition']} opposition)" if kind else ""


def answers_words(answers: Sequence[Document]) -> list[str]:
    """One line about each answer of a plan: its name, its score, and why it is not reached, if so."""
    lines = []
    for name, answer in zip(answer_names(answers), answers, strict=True):
        status = answer["hand"]["status"] or "not tried"
        state = "" if status == "reached" else f", {status}"
        lines.append(f"{name}, {score_name(answer)} {score(answer):.2f}{state}")
    return lines


def answer_names(answers: Sequence[Document]) -> list[str]:
    """A name for each answer of a plan, distinct among them.

    A grip's name has its type, the side from which the hand comes in, the part that it holds, and the width
    between the thumb and the others. A virtual grasp's name has plane and approach value instead of a type.
    An answer whose name an earlier one has already also says where its thumb stands, or how far along an axis
    its contacts lie. So a name does not change when further answers are found.
    """
    names: list[str] = []
    for i, answer in enumerate(answers):
        base = _base_name(answer)
        same = [other for other, name in zip(answers[:i], names, strict=True) if name.startswith(base)]
        names.append(next(name for name in _longer(base, _told_apart(answer, same)) if name not in names))
    return names


def _longer(base: str, words: Iterator[str]) -> Iterator[str]:
    yield base
    yield from (f"{base}, {more}" for more in words)


def _base_name(answer: Document) -> str:
    side, width = _side(answer), _opposed_width(answer)
    kind = (answer.get("grip") or {}).get("type")
    if kind:
        name = f"{kind['name']} {side}"
    else:
        name = f"plane {answer['plane']} at {answer['approach_value']:+.2f}, {side}"
    if answer.get("part"):
        name += f" on {answer['part']}"
    return name if width is None else f"{name}, {1000 * width:.0f} mm"


def _side(answer: Document) -> str:
    """Where the hand comes from: above, below, or the side of the object as a signed axis."""
    way = way_in(answer)
    up = (answer.get("scene") or {}).get("up") or (0.0, 0.0, 1.0)
    rise = -_dot(way, up)
    if abs(rise) > STEEP:
        return "from above" if rise > 0 else "from below"
    return f"from {axis_words([-x for x in way])}"


def _opposed_width(answer: Document) -> float | None:
    """Distance between the thumb's contacts, or the first finger's, and those of the others [m]."""
    contacts = answer["contacts"]
    names = [str(contact["finger"]) for contact in contacts]
    first = "thumb" if "thumb" in names else next(iter(names), "")
    one = _middle([c["point"] for c in contacts if c["finger"] == first])
    rest = _middle([c["point"] for c in contacts if c["finger"] != first])
    return math.dist(one, rest) if one and rest else None


def _told_apart(answer: Document, same: Sequence[Document]) -> Iterator[str]:
    """What tells an answer from those of the same name, the shortest first; it never ends."""
    thumb = f"thumb at {thumb_side(answer)}"
    yield thumb
    middle = _middle([contact["point"] for contact in answer["contacts"]])
    if middle:
        found = [_middle([contact["point"] for contact in other["contacts"]]) for other in same]
        apart = [max((abs(m[i] - middle[i]) for m in found if m), default=0.0) for i in range(3)]
        axis = apart.index(max(apart))
        where = f"at {'XYZ'[axis]} {1000 * middle[axis] + 0.0:+.0f} mm"
        yield where
        yield f"{thumb}, {where}"
    yield from (f"no. {number}" for number in count(2))


def _middle(points: Sequence[Sequence[float]]) -> list[float]:
    """Mean of some points; empty without one."""
    return [sum(column) / len(points) for column in zip(*points, strict=True)] if points else []


def touching_words(answer: Document) -> tuple[str, str]:
    """Number of fingers that touch, and `` and the palm`` if it touches too."""
    parts = {c["finger"] for c in answer["contacts"]}
    return str(len(parts - {"palm"})), " and the palm" if "palm" in parts else ""


def refused(answer: Document) -> str:
    """What keeps the hand from executing a grip, as a clause; empty if nothing does."""
    hand = answer["hand"]
    return str(hand["reason"]) if answer.get("grip") and hand["status"] == "blocked" else ""


def load_words(answer: Document) -> str:
    """The load that the margins of a grip are about: the planned mass, at the press of the squeeze."""
    return f"for {answer.get('mass', FIELD_MASS):.3g} kg at a press of {press(answer):.0f} N"


def mass_words(answer: Document) -> str:
    """Mass used in planning, where it comes from, and the largest mass that the grip holds."""
    if "mass_source" not in answer:
        return f"{FIELD_MASS:g} kg (assumed by plans of version 1)"
    words = ObjectMass(kg=float(answer["mass"]), source=str(answer["mass_source"])).words
    most = answer.get("heaviest_mass")
    return words if most is None else f"{words}; this grip holds up to {most:.2g} kg at its strongest press"


def arm_words(answer: Document) -> str:
    """What the arm makes of an answer; empty without an arm.

    >>> arm_words({"arm": {"name": "ur5", "status": "collision", "reason": "it would hit the table"}})
    'ur5 does not reach it: it would hit the table'
    """
    arm = answer.get("arm")
    if not arm or arm["status"] is None:
        return ""
    if not arm.get("path"):
        return f"{arm['name']} does not reach it: {arm['reason']}"
    room = (
        "" if arm["limit_room"] is None else f"{math.degrees(arm['limit_room']):.0f}° from its joint limits, "
    )
    seconds = arm["path"]["times"][-1]
    return f"{arm['name']} reaches it: {room}condition {arm['condition']:.0f}, {seconds:.1f} s on its way"


def scene_words(document: Document) -> str:
    """Friction, table, boxes and allowed approaches used in planning; empty if planning used none of them."""
    request = document.get("request") or {"friction": FRICTION}
    closure, words = request.get("analyser", "closure") == "closure", []
    if closure or request["verify"]:
        words.append(f"friction {request['friction']:g}")
    if closure:
        table, boxes = request.get("table"), len(request.get("avoid") or ())
        if table is None:
            words.append("no table")
        else:
            height = "under the object" if table == "auto" else f"at z = {1000 * table:.0f} mm"
            words.append(f"table {height}{_turned(document.get('scene') or {})}")
        if boxes:
            words.append(f"{boxes} box{'es' if boxes > 1 else ''} to avoid")
    if (request.get("object") or {}).get("mask") is not None:
        words.append("the rest of the scene in the way")
    if request.get("obstacle"):
        words += [f"obstacle {text.replace(chr(92), '/').rpartition('/')[2]}" for text in request["obstacle"]]
    if request.get("approaches"):
        words.append(f"approaches {request['approaches']}")
    return ", ".join(words)


def rules_words(document: Document) -> str:
    """Which parts are held and which stay free, and where this comes from; empty without rules.

    >>> rules_words({"rules": [{"kind": "hold_on", "part": "handle", "origin": "object", "table": False}]})
    'hold on handle (for this object and task)'
    """
    origins = {"asked": "as asked", "object": "for this object and task", "task": "for this task"}
    said: dict[str, list[str]] = {}
    for rule in document.get("rules") or ():
        kind = str(rule["kind"]).replace("_", " ")
        said.setdefault(str(rule["origin"]), []).append(f"{kind} {rule['part']}")
    return "; ".join(f"{', '.join(rules)} ({origins.get(origin, origin)})" for origin, rules in said.items())


def _turned(scene: Document) -> str:
    """How the object lies at rest, if it is turned from how it is modelled."""
    if float(scene.get("turned", 0.0)) < TURNED:
        return ""
    up = ", ".join(f"{round(x, 2) + 0.0:g}" for x in scene["up"])
    return f", on which it lies turned by {scene['turned']:.0f}°: up is {up}"


def _angle(a: Sequence[float], b: Sequence[float]) -> float:
    """Angle between two vectors [degrees]."""
    cosine = _dot(a, b) / math.sqrt(_dot(a, a) * _dot(b, b))
    return math.degrees(math.acos(max(-1.0, min(1.0, cosine))))


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(float(x) * float(y) for x, y in zip(a, b, strict=True))
