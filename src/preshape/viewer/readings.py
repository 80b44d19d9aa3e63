"""A plan's results as small pieces of HTML, for the browser's panel, the page and the picture.

The paper's indices come first for a virtual grasp only. Every text of a plan is escaped, because names come
from files.
"""

from __future__ import annotations

from collections.abc import Sequence

from ..report.plain import html_text as escape
from ..types import quality_text, two_digits
from .words import (
    QUALITY,
    Document,
    answers_of,
    answers_words,
    arm_words,
    correction_words,
    figures,
    fingers_words,
    load_words,
    mass_words,
    mode_words,
    odds_words,
    plan_mode,
    plane_words,
    press,
    refused,
    result,
    rules_words,
    scene_words,
    score,
    score_name,
    step_words,
    type_words,
    way_in_words,
)

COMPONENTS = ("Tx", "Ty", "Tz", "Rx", "Ry", "Rz")
_MODE_SENTENCES = {
    0: "a stored grasp or the network's estimate is good enough",
    1: "the network named the plane, and the whole plane was searched",
    2: "the object is known, another task is asked for",
    3: "all allowed planes were explored",
}
OUTCOMES = {"reward": "good", "learned": "good", "explored": "good", "known": "warn", "unknown": "warn"}

WORDS = (
    ("quality", f"score of a real hand's grip, 0 to 6: {QUALITY}"),
    ("task margin", "largest load of the task that the squeeze balances, divided by the expected load"),
    ("hold margin", "the same for pushes and turns from any side"),
    ("press", "sum of the normal forces with which the hand squeezes"),
    ("way in", "straight line along which the open hand moves to the object"),
    ("approach plane", "one of twelve combinations of an approach axis, along which the hand moves, and an "
     "opposition axis, along which thumb and fingers oppose each other"),
    ("approach value", "place along the approach axis at which the grasp is aimed: -1 near face, 0 middle, "
     "+1 far face"),
    ("task", "six numbers: translation (T) along and rotation (R) about x, y and z"),
    ("net wrench", "force and torque of all contacts together on the object, if every finger presses alike"),
    ("match (TFVADI)", "agreement of task and net wrench in all six components, 0 to 6; ADI: in one, 0 to 1"),
    ("stability", "number of directions in which the contacts resist without pressing harder"),
    ("manipulability", "number of directions in which the contacts can act on the object"),
    ("mode", "0 known: recalled, or estimated if no lesson of the object is stored; 1 searched: plane "
     "estimated, then searched; 2: known, but the task does not fit; 3 new: explored and learnt"),
)  # fmt: skip
"""Meanings of the words in the readings."""

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
"""Style sheet; its rules apply inside an element of class ``ps``."""


def wrapped(*parts: str) -> str:
    """Pieces of HTML as one element with its style."""
    return f'<div class="ps"><style>{STYLE}</style>{"".join(parts)}</div>'


def headline(document: Document) -> str:
    """Result, request, deciding numbers or reason, mode and time; the panel may show another request."""
    sign, kind, title = result(document)
    asked = document["task"]["name"] or "six numbers"
    lines = [" · ".join((document["object"]["name"], asked, document["hand"]["name"]))]
    shown = answers_of(document)
    if shown and shown[0].get("grip"):
        lines.append(" · ".join(" ".join(part).rstrip() for part in figures(shown[0])))
    # A reason comes before what is less urgent: a phone shows the beginning only.
    if correction := correction_words(document):
        lines += correction
    elif not document.get("plane") and document.get("reason"):
        lines.append(str(document["reason"]))
    seconds = float(document.get("seconds", {}).get("total", 0.0))
    time = f" · {seconds:.1f}\u00a0s" if seconds else ""
    lines.append(f"{plan_mode(document)}: {_MODE_SENTENCES.get(document['mode'], '')}{time}")
    text = "<br>".join(escape(line) for line in lines)
    return f'<div class="head {kind}"><b>{sign} {escape(title)}</b>{text}</div>'


def transitions(document: Document) -> str:
    """Every step of the search with its mode, outcome and reason."""
    steps = []
    for t in document["transitions"]:
        kind = OUTCOMES.get(t["outcome"], "bad" if t["mode"] == 3 else "warn")
        steps.append(
            f'<div class="step {kind}"><b>{escape(step_words(t))}</b><br>{escape(t["reason"])}</div>'
        )
    return "<h3>How it was found</h3>" + "".join(steps)


def why(document: Document, answers: Sequence[Document], shown: int) -> str:
    """Two sentences: where this grasp comes from, and how good the best grasp on another plane is."""
    answer = answers[shown]
    name, need = score_name(answer), document["thresholds"]["estimation"]
    points = f"{name} {score(answer):.2f} of 6, where {need:g} is enough"
    if not document.get("plane"):
        but = f", but {refused(answer)}" if refused(answer) else ""
        first = (
            f"No grasp is good enough. This is the best that was found, on plane {answer['plane']}: "
            f"{points}{but}. It should not be executed."
        )
    elif shown:
        first = f"This is answer {shown + 1}: plane {answer['plane']}, {points}."
    else:
        met = "The object is known" if document.get("known", True) else "No lesson of this object is stored"
        how = _MODE_SENTENCES.get(document["mode"], "")
        first = f"{met}; {how}: plane {answer['plane']}, {points}."
    others = [a for a in answers if a["plane"] != answer["plane"]]
    second = ""
    if others and not shown:
        best = max(others, key=score)
        second = escape(f" The best on another plane: plane {best['plane']}, {name} {score(best):.2f}.")
        second += planes_compared(answers, need)
    return f"<h3>Why this grasp</h3><p>{escape(first)}{second}</p>"


def planes_compared(answers: Sequence[Document], need: float) -> str:
    """A bar for each of the twelve planes: the best answer there, if one of the answers is on it.

    Args:
        answers: The answers of a plan.
        need: The score that is enough.
    """
    found: dict[int, float] = {}
    for answer in answers:
        found[answer["plane"]] = max(score(answer), found.get(answer["plane"], 0.0))
    rows = []
    for index in range(1, 13):
        most = found.get(index)
        colour = "#009E73" if most is not None and most >= need else "#E69F00"
        bar = (
            "" if most is None else f'<i style="left:0;width:{min(most / 6, 1):.0%};background:{colour}"></i>'
        )
        number = "–" if most is None else f"{most:.2f}"
        rows.append(
            f'<tr><th>{index}</th><td style="width:75%"><div class="track">{bar}</div></td>'
            f'<td class="num">{number}</td></tr>'
        )
    words = f"best of the {len(answers)} answers on each of the twelve planes, 0 to 6; – has none among them"
    return f'<table>{"".join(rows)}</table><span class="quiet">{words}</span>'


def glossary() -> str:
    """Meanings of the words, collapsed at first."""
    return f"<details><summary>What the words mean</summary>{_table(WORDS)}</details>"


def answer_parts(document: Document, answers: Sequence[Document], shown: int) -> list[str]:
    """Everything about one answer, the most important first.

    For a grip, the paper's indices come last, collapsed. For a virtual grasp they decide and are shown open.
    """
    answer = answers[shown]
    first = [why(document, answers, shown), facts(document, answer)]
    if not answer.get("grip"):
        return [*first, bars(document, answer), transitions(document)]
    explained = _table(_index_rows(answer)) + bars(document, answer)
    folded = f"<details><summary>Explain: the paper's indices</summary>{explained}</details>"
    return [*first, transitions(document), folded]


def fact_rows(document: Document, answer: Document) -> list[tuple[str, str]]:
    """Names and values of the facts that decided an answer and of the assumptions behind it."""
    grip = answer.get("grip")
    enough = f"of 6, {document['thresholds']['estimation']:g} is enough"
    place = [("way in", way_in_words(answer)), ("plane", f"{answer['plane']}, {plane_words(answer)}")]
    if not grip:
        rows = [("match (TFVADI)", f"{answer['tfvadi']:.2f} {enough}"), *place, *_index_rows(answer)[1:]]
        rows.append(("fingers", fingers_words(answer)))
    else:
        rows = [
            ("quality", f"{quality_text(grip['quality'])} {enough}"),
            ("task margin", f"{two_digits(grip['task_margin'])} × the task's load, {load_words(answer)}"),
            ("hold margin", f"{two_digits(grip['hold_margin'])} × pushes from any side"),
            *([("pick-up", odds_words(answer))] if odds_words(answer) else []),
            ("press", f"{press(answer):.1f} N in all"),
            ("mass", mass_words(answer)),
            ("scene", scene_words(document)),
            ("refused", refused(answer))
            if refused(answer)
            else ("clearance", f"{1000 * grip['clearance']:.1f} mm to the object on the way in"),
            *place,
            *([("type", type_words(answer))] if type_words(answer) else []),
            ("touching", fingers_words(answer)),
        ]
    if rules_words(document):
        rows.append(("rules", rules_words(document)))
    if answer.get("verified"):
        rows.append(("physics", str(answer["verified"]["reason"])))
    if answer.get("cloud"):
        rows.append(("point cloud", str(answer["cloud"]["sentence"])))
    return rows


def _index_rows(answer: Document) -> list[tuple[str, str]]:
    """The paper's indices of an answer."""
    value = f"{answer['approach_value']:+.2f} ({answer['approach_set']}): {_place(answer)}"
    return [
        ("match (TFVADI)", f"{answer['tfvadi']:.2f} of 6; a real hand is not judged by it"),
        ("approach value", value),
        ("stability", f"{answer['stability']} of 6"),
        ("manipulability", f"{answer['manipulability']} of 6"),
    ]


def facts(document: Document, answer: Document) -> str:
    """What decided an answer, whether the hand can execute it, and its warnings."""
    hand = answer["hand"]
    status = hand["status"] or "not tried yet"
    kind = "good" if status == "reached" else "bad" if hand["status"] else "warn"
    tried = (
        f'<div class="step {kind}"><b>Hand {escape(hand["name"])}: {escape(status)}</b><br>'
        f"{escape(hand['reason'] or '')}</div>"
    )
    notes = "".join(f'<div class="step warn">{escape(w)}</div>' for w in answer.get("warnings", []))
    if arm := arm_words(answer):
        kind = "good" if answer["arm"]["path"] else "bad"
        tried += f'<div class="step {kind}"><b>Arm</b><br>{escape(arm)}</div>'
    return f"<h3>This answer</h3>{_table(fact_rows(document, answer))}{tried}{notes}"


def bars(document: Document, answer: Document) -> str:
    """Task and net wrench, component by component, with their agreement (ADI)."""
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
            '<p class="quiet">The paper\'s measure, for comparison: the wrench of the contacts if all '
            "pressed alike. A real hand is judged by its grip: each finger presses as the task needs.</p>"
        ) + key
    return f"<h3>Task against net wrench</h3>{key}<table>{''.join(rows)}</table>"


def ranking(answers: Sequence[Document], shown: int) -> str:
    """All answers in the plan's order; the shown one in bold."""
    rows = []
    for i, words in enumerate(answers_words(answers)):
        mark, kind = ("▸", "on") if i == shown else ("", "off")
        rows.append(
            f'<tr data-answer="{i}" class="{kind}"><td>{mark}</td>'
            f"<td>{i + 1}</td><td>{escape(words)}</td></tr>"
        )
    good = any(answer.get("status") == "answer" for answer in answers)
    title = (
        "The answer, then the alternatives by score" if good else "The best that was found, not good enough"
    )
    return f"<h3>{title}</h3><table>{''.join(rows)}</table>"


def offers(document: Document) -> str:
    """Tasks that fit the object, if the requested one does not (mode 2)."""
    rows = "".join(
        f"<tr><td><b>{escape(str(o['task']))}</b></td>"
        f"<td>{o['tfvadi']:.2f} of 6, {escape(mode_words(o['mode']))}</td></tr>"
        for o in document.get("offers", [])
    )
    return f"<h3>Tasks that do fit</h3><table>{rows}</table>" if rows else ""


def _table(rows: Sequence[tuple[str, str]]) -> str:
    """Names and values as a table."""
    cells = "".join(f"<tr><th>{escape(k)}</th><td>{escape(v)}</td></tr>" for k, v in rows)
    return f"<table>{cells}</table>"


def _place(answer: Document) -> str:
    v = float(answer["approach_value"])
    where = "at the middle" if abs(v) < 0.2 else "towards the far side" if v > 0 else "towards the near side"
    return f"aimed {where}"


def _number(x: float) -> str:
    """A number with two decimals and a sign; zero has a plus."""
    return f"{round(float(x), 2) + 0.0:+.2f}"


def _bar(number: float, colour: str) -> str:
    """A bar from the middle to the left or to the right; ±1.2 fills the width."""
    half = min(1.0, abs(float(number)) / 1.2) * 50
    left = 50 - half if number < 0 else 50.0
    return (
        f'<div class="track"><i style="left:{left:.1f}%;width:{half:.1f}%;background:{colour}"></i>'
        '<i class="zero"></i></div>'
    )
