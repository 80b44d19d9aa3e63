"""What a plan says, as small pieces of HTML: the same in the browser's panel and on the page.

Every text of a plan is escaped: names come from files.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

Document = dict[str, Any]

COMPONENTS = ("Tx", "Ty", "Tz", "Rx", "Ry", "Rz")
HEADLINES = {
    "answer": ("✓", "good", "Preshape found"),
    "task_correction": ("?", "warn", "The object is known, but this task does not fit it"),
    "deadlock": ("✕", "bad", "Deadlock: nothing matches well enough"),
    "no_grasp": ("✕", "bad", "No grasp: nothing that was tried holds the object"),
}
MODES = {
    0: "recalled at once: the estimator named this grasp",
    1: "recalled the plane, searched on it",
    2: "recognised the object and asks for another task",
    3: "explored all planes, and learned",
}
OUTCOMES = {"reward": "good", "learned": "good", "explored": "good", "known": "warn", "unknown": "warn"}

WORDS = (
    ("approach plane", "one of twelve ways in: along which axis the hand moves, and along which thumb and "
     "fingers oppose each other"),
    ("approach value", "where along that way the grasp is aimed: -1 near face, 0 middle, +1 far face"),
    ("task", "six numbers: how much the object is to move along (T) and turn about (R) x, y and z"),
    ("net wrench", "what the fingers' contacts do to the object together: force and torque"),
    ("match (TFVADI)", "how well task and net wrench agree in all six, 0 to 6; ADI: in one, 0 to 1"),
    ("grip's quality", "of a real hand: how much load its squeeze balances against what the task needs"),
    ("stability", "how many directions the contacts resist without pressing harder"),
    ("manipulability", "in how many directions the contacts can act on the object"),
    ("modes", "0: recalled; 1: recalled and searched; 2: known, another task is asked for; 3: learned anew"),
)  # fmt: skip
"""What the readings' words mean, for people."""

STYLE = """
.ps{font:13px/1.45 system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif;color:#22262B;
padding:0 10px}
.ps h3{font-size:13px;margin:12px 0 4px;color:#22262B;font-weight:650}
.ps table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
.ps td,.ps th{padding:2px 6px 2px 0;text-align:left;vertical-align:top;font-weight:400}
.ps th{color:#59626D;white-space:nowrap}
.ps .num{text-align:right;white-space:nowrap}
.ps .head{border-left:4px solid #6B7480;background:#F3F5F8;padding:7px 10px;
border-radius:4px;margin:4px 0 8px}
.ps .head b{display:block;font-size:14px}
.ps .good{border-color:#009E73}.ps .warn{border-color:#E69F00}.ps .bad{border-color:#D55E00}
.ps .head.good{background:#EAF6F2}.ps .head.warn{background:#FDF5E4}.ps .head.bad{background:#FBEEE5}
.ps .step{border-left:3px solid #C9CFD6;padding:1px 0 1px 9px;margin:5px 0}
.ps .step.good{border-color:#009E73}.ps .step.warn{border-color:#E69F00}.ps .step.bad{border-color:#D55E00}
.ps tr.on td{font-weight:650}
.ps .quiet{color:#59626D}
.ps .track{position:relative;height:9px;background:#E8ECF0;border-radius:2px;overflow:hidden}
.ps .track i{position:absolute;top:0;bottom:0}
.ps .zero{left:50%;width:1px;background:#8791A0}
.ps details{margin:12px 0 4px}.ps summary{cursor:pointer;font-weight:650}
.ps .chip{display:inline-block;width:9px;height:9px;border-radius:2px;margin-right:4px}
"""
"""Style sheet; everything stands in an element of class ``ps``."""


def answers_of(document: Document) -> list[Document]:
    """Every answer of a plan, best first: the answer itself and the alternatives."""
    first = [document] if document.get("plane") else []
    return [*first, *document.get("alternatives", [])]


def wrapped(*parts: str) -> str:
    """Pieces as one element with its style."""
    return f'<div class="ps"><style>{STYLE}</style>{"".join(parts)}</div>'


def headline(document: Document) -> str:
    """How the run ended, in which mode, in how much time, and what it was about: more may be chosen since."""
    sign, kind, words = HEADLINES.get(str(document["status"]), ("", "warn", str(document["status"])))
    mode = document["mode"]
    seconds = float(document.get("seconds", {}).get("total", 0.0))
    time = f" · {seconds:.1f} s" if seconds else ""
    if document["status"] == "task_correction":
        time += (
            "<br>Tasks that do fit are offered; or teach this one."
            if document.get("offers")
            else "<br>No named task fits either: ask for less match, or teach this one."
        )
    asked = document["task"]["name"] or "six numbers"
    about = " · ".join((document["object"]["name"], asked, document["hand"]["name"]))
    return (
        f'<div class="head {kind}"><b>{sign} {escape(words)}</b>'
        f"{escape(about)}<br>Mode {mode}: {escape(MODES.get(mode, ''))}{time}</div>"
    )


def transitions(document: Document) -> str:
    """Every mode with its outcome and reason."""
    steps = []
    for t in document["transitions"]:
        kind = OUTCOMES.get(t["outcome"], "bad" if t["mode"] == 3 else "warn")
        steps.append(
            f'<div class="step {kind}"><b>Mode {t["mode"]} · {escape(t["outcome"])}</b><br>'
            f"{escape(t['reason'])}</div>"
        )
    return "<h3>How it was found</h3>" + "".join(steps)


def why(document: Document, answers: Sequence[Document], shown: int) -> str:
    """In two sentences: how this plane was come by, and what it is better than."""
    answer = answers[shown]
    name, need = _measure(answer), document["thresholds"]["estimation"]
    worth = f"{name} {_worth(answer):.2f} of 6, where {need:g} is enough"
    if shown:
        first = (
            f"This is another way, number {shown + 1} in order of {name}: plane {answer['plane']}, {worth}."
        )
    elif document["mode"] == 0:
        first = (
            f"From what it has learnt, the network named plane {answer['plane']}, where on it, and how many "
            f"fingers; that grasp was tried and is good enough: {worth}."
        )
    elif document["mode"] == 1:
        first = (
            f"From what it has learnt, the network named plane {answer['plane']}; its first aim was not good "
            f"enough, so all of that plane was searched. The best found there: {worth}."
        )
    else:
        first = (
            f"The object was new, so all twelve planes were tried; the best grasp lies on plane "
            f"{answer['plane']}: {worth}."
        )
    others = [a for a in answers if a["plane"] != answer["plane"]]
    second = ""
    if others and not shown:
        best = max(others, key=_worth)
        second = f" The best on another plane: plane {best['plane']}, {name} {_worth(best):.2f}."
    return f"<h3>Why this plane</h3><p>{escape(first + second)}</p>"


def _measure(answer: Document) -> str:
    return "quality" if answer.get("grip") else "match"


def _worth(answer: Document) -> float:
    grip = answer.get("grip")
    return float(grip["quality"] if grip else answer["tfvadi"])


def glossary() -> str:
    """What the words mean, folded away."""
    rows = "".join(f"<tr><th>{escape(word)}</th><td>{escape(means)}</td></tr>" for word, means in WORDS)
    return f"<details><summary>What the words mean</summary><table>{rows}</table></details>"


def facts(document: Document, answer: Document) -> str:
    """The answer in words: plane, approach value, fingers, indices, what the hand made of it."""
    hand = answer["hand"]
    said = hand["status"] or "not tried yet"
    kind = "good" if said == "reached" else "bad" if hand["status"] else "warn"
    rows = [
        ("plane", f"{answer['plane']}: {plane_words(answer)}"),
        ("approach value", f"{answer['approach_value']:+.2f} ({answer['approach_set']}): {_place(answer)}"),
        ("fingers", ", ".join(c["finger"] for c in answer["contacts"]) or str(answer["fingers"])),
    ]
    grip = answer.get("grip")
    enough = f"of 6, {document['thresholds']['estimation']:g} is enough"
    if grip:
        rows += [
            ("grip's quality", f"{grip['quality']:.2f} {enough}"),
            ("margin, task", f"{grip['task_margin']:.2f} × the task's load"),
            ("margin, holding", f"{grip['hold_margin']:.2f} × the pushes expected"),
            ("way in", f"{1000 * grip['clearance']:.1f} mm clear"),
            ("match (TFVADI)", f"{answer['tfvadi']:.2f} of 6; a real hand is not judged by it"),
        ]
    else:
        rows.append(("match (TFVADI)", f"{answer['tfvadi']:.2f} {enough}"))
    rows += [("stability", f"{answer['stability']}"), ("manipulability", f"{answer['manipulability']}")]
    verified = answer.get("verified")
    if verified:
        rows.append(("physics", verified["reason"]))
    table = "".join(f"<tr><th>{escape(k)}</th><td>{escape(str(v))}</td></tr>" for k, v in rows)
    why = hand["reason"] or ""
    tried = (
        f'<div class="step {kind}"><b>Hand {escape(hand["name"])} · {escape(said)}</b><br>{escape(why)}</div>'
    )
    notes = "".join(
        f'<div class="step warn">{escape(w)}</div>' for w in answer.get("warnings", []) if not grip
    )
    return f"<h3>This answer</h3><table>{table}</table>{tried}{notes}"


def bars(document: Document, answer: Document) -> str:
    """Task against net wrench, component by component, with their agreement (ADI)."""
    rows = []
    for name, q, w, degree in zip(
        COMPONENTS, document["task"]["q"], answer["net_wrench"], answer["adi"], strict=True
    ):
        rows.append(
            f'<tr><th>{name}</th><td style="width:62%">{_bar(q, "#4A4F57")}<div style="height:2px"></div>'
            f'{_bar(w, "#56B4E9")}</td><td class="num">{_number(q)}<br>'
            f'<span class="quiet">{_number(w)}</span></td><td class="num"><b>{degree:.2f}</b></td></tr>'
        )
    key = (
        '<div class="quiet"><span class="chip" style="background:#4A4F57"></span>task '
        '&nbsp;<span class="chip" style="background:#56B4E9"></span>net wrench of the grasp '
        "&nbsp;· last column: agreement (ADI), 1 is full</div>"
    )
    if answer.get("grip"):
        key = (
            '<p class="quiet">The paper\'s measure, for comparison: what the contacts would do if all '
            "pressed alike. A real hand is judged by its grip: each finger presses as the task needs.</p>"
        ) + key
    return f"<h3>Task against net wrench</h3>{key}<table>{''.join(rows)}</table>"


def ranking(answers: Sequence[Document], shown: int) -> str:
    """All answers, best first; the one that is shown in bold."""
    rows = []
    for i, answer in enumerate(answers):
        mark, kind = ("▸", "on") if i == shown else ("", "off")
        rows.append(
            f'<tr data-answer="{i}" class="{kind}"><td>{mark}</td>'
            f"<td>{i + 1}</td><td>{escape(answer_words(answer))}</td></tr>"
        )
    return f"<h3>The answer, then other ways, best first</h3><table>{''.join(rows)}</table>"


def offers(document: Document) -> str:
    """Tasks that do fit the object, where the one asked for does not (mode 2)."""
    rows = "".join(
        f"<tr><td><b>{escape(str(o['task']))}</b></td><td>match {o['tfvadi']:.2f}, mode {o['mode']}</td></tr>"
        for o in document.get("offers", [])
    )
    return f"<h3>Tasks that do fit</h3><table>{rows}</table>" if rows else ""


def answer_words(answer: Document) -> str:
    """One line about an answer: plane, fingers, what it is worth, whether the hand reaches it."""
    grip = answer.get("grip")
    worth = f"quality {grip['quality']:.2f}" if grip else f"match {answer['tfvadi']:.2f}"
    state = answer["hand"]["status"] or "not tried"
    fingers = len(answer["contacts"]) if grip else answer["fingers"]
    return f"plane {answer['plane']}, {fingers} fingers, {worth}, {state}"


def plane_words(answer: Document) -> str:
    """An answer's axes in words."""
    return (
        f"the hand moves along {_axis(answer['approach_axis'])}, thumb and fingers oppose "
        f"along {_axis(answer['opposition_axis'])[1]}"
    )


def _place(answer: Document) -> str:
    v = float(answer["approach_value"])
    where = "at the middle" if abs(v) < 0.2 else "towards the far side" if v > 0 else "towards the near side"
    return f"aimed {where}"


def _axis(axis: Sequence[float]) -> str:
    i = max(range(3), key=lambda k: abs(axis[k]))
    return ("+" if axis[i] > 0 else "-") + "XYZ"[i]


def _number(x: float) -> str:
    """Two digits with a sign, and no minus before a nought."""
    return f"{round(float(x), 2) + 0.0:+.2f}"


def _bar(number: float, colour: str) -> str:
    """A bar from the middle to the left or the right; ±1.2 is the whole width."""
    half = min(1.0, abs(float(number)) / 1.2) * 50
    left = 50 - half if number < 0 else 50.0
    return (
        f'<div class="track"><i style="left:{left:.1f}%;width:{half:.1f}%;background:{colour}"></i>'
        '<i class="zero"></i></div>'
    )
