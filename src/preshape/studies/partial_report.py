"""The figures on partial views as tables for people."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from .._version import __version__
from ..files import write_json
from ..physics.hold.tables import TextTable, markdown_table
from ..physics.measures import wilson
from .partial_views import CloudRun
from .report import write_pages

TRUSTS = (0.0, 0.4, 0.7, 1.0)
"""Bounds of the table by trust."""
_WORDS = {"symmetry": "by symmetry (used)", "straight": "straight back", "hull": "convex hull of the points"}


def figures(run: CloudRun, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """All figures of a study.

    Args:
        run: what was measured.
        rows: one for each hand and view.
    """
    hands = {}
    for hand in dict.fromkeys(row["hand"] for row in rows):
        own = [row for row in rows if row["hand"] == hand]
        wholes = {row["case"]: row["whole"] for row in own}
        hands[hand] = {
            "whole_mesh": _share(list(wholes.values())),
            "cloud": _share([row["held"] for row in own]),
            "cloud_by_margin_alone": _share([row["by_margin"] for row in own]),
            "where_the_whole_mesh_held": _share([row["held"] for row in own if row["whole"]]),
            "objects": {
                case: {"whole": held, **_share([row["held"] for row in own if row["case"] == case])}
                for case, held in wholes.items()
            },
        }
    answered = [row for row in rows if "trust" in row]
    return {
        "status": "answer",
        "version": __version__,
        "run": run.key,
        "hands": hands,
        "shapes": {method: _shape(rows, method) for method in run.methods},
        "trust": [
            {
                "from": low,
                "to": high,
                **_share([r["held"] for r in answered if _within(r["trust"], low, high)]),
            }
            for low, high in pairwise(TRUSTS)
        ],
        "seen_share": _mean([row["seen_share"] for row in answered]),
        "contacts_seen": _mean([float(np.mean(row["contacts_seen"])) for row in answered]),
        "refused": [
            {"hand": row["hand"], "case": row["case"], "view": row["view"], "reason": row["refused"]}
            for row in rows
            if "refused" in row
        ],
    }


def _within(trust: float, low: float, high: float) -> bool:
    return low <= trust < high or trust == high == TRUSTS[-1]


def _share(held: Sequence[bool]) -> dict[str, Any]:
    count, good = len(held), sum(held)
    return {
        "tested": count,
        "held": good,
        "share": good / count if count else None,
        "interval": wilson(good, count),
    }


def _shape(rows: Sequence[dict[str, Any]], method: str) -> dict[str, Any]:
    seen = {(row["case"], row["view"]): row["shapes"][method] for row in rows if "shapes" in row}
    found = list(seen.values())
    return {
        "views": len(found),
        "iou": _mean([shape["iou"] for shape in found]),
        "chamfer": _mean([shape["chamfer"] for shape in found]),
    }


def _mean(numbers: Sequence[float]) -> float | None:
    return float(np.mean(numbers)) if numbers else None


def tables(document: dict[str, Any]) -> list[TextTable]:
    """The figures as tables of text."""
    success = [
        (
            hand,
            _text(own["whole_mesh"]),
            _text(own["cloud"]),
            _text(own["where_the_whole_mesh_held"]),
            _text(own["cloud_by_margin_alone"]),
        )
        for hand, own in document["hands"].items()
    ]
    shapes = [
        (_WORDS[method], str(own["views"]), _number(own["iou"], "{:.2f}"), _millimetres(own["chamfer"]))
        for method, own in document["shapes"].items()
    ]
    trusts = [(f"{row['from']:.1f} to {row['to']:.1f}", _text(row)) for row in document["trust"]]
    objects = [
        (hand, case, "held" if one["whole"] else "lost", f"{one['held']} of {one['tested']}")
        for hand, own in document["hands"].items()
        for case, one in own["objects"].items()
    ]
    return [
        TextTable(
            caption="Answers that held in the six-direction test of the true object (95 % interval)",
            columns=("hand", "whole mesh", "cloud", "cloud, where mesh held", "cloud, margin alone"),
            rows=tuple(success),
        ),
        TextTable(
            caption="How like the true object the guessed one is: shared volume, mean distance of surfaces",
            columns=("far side guessed", "views", "IoU", "mm"),
            rows=tuple(shapes),
        ),
        TextTable(caption="Answers that held, by trust", columns=("trust", "held"), rows=tuple(trusts)),
        TextTable(
            caption="Objects", columns=("hand", "object", "whole mesh", "views held"), rows=tuple(objects)
        ),
    ]


def _text(share: dict[str, Any]) -> str:
    if not share["tested"]:
        return "–"
    low, high = share["interval"]
    return f"{share['held']} of {share['tested']}, {share['share']:.0%} ({low:.0%}-{high:.0%})"


def _number(found: float | None, form: str) -> str:
    return "–" if found is None else form.format(found)


def _millimetres(found: float | None) -> str:
    return "–" if found is None else f"{1000 * found:.1f}"


def write_report(document: dict[str, Any], folder: Path) -> list[Path]:
    """Write report.json, report.md and report.html, each whole or not at all.

    Raises:
        EnvironmentFailure: a file cannot be written.
    """
    run = document["run"]
    lines = [
        "# Grasps on partial views",
        "",
        f"preshape {document['version']}; {run['views']} views of each object, noise "
        f"{1000 * run['noise']:g} mm, seed {run['seed']}, task {run['task']}.",
    ]
    for table in tables(document):
        lines += ["", f"**{table.caption}**", "", *markdown_table(table)]
    if document["refused"]:
        lines += ["", "**Views without an answer**", ""]
        lines += [f"- {r['hand']}, {r['case']}, view {r['view']}: {r['reason']}" for r in document["refused"]]
    write_json(folder / "report.json", document)
    return [folder / "report.json", *write_pages(folder, "\n".join(lines) + "\n")]
