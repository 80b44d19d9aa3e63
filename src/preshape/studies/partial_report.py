"""Figures and report of the study on partial views."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from .._version import __version__
from ..physics.measures import mean, wilson
from ..report import Bullets, Chapter, Report, Table, write_report
from .partial_views import CloudRun

TRUST_LIMITS = (0.0, 0.4, 0.7, 1.0)
"""Limits of the classes in the table of results by trust."""
_METHODS = {
    "symmetry": "by symmetry (used)",
    "straight": "straight back",
    "hull": "convex hull of the points",
}


def cloud_figures(run: CloudRun, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """All figures of the study as plain JSON values.

    Args:
        run: Settings of the study.
        rows: One row for each hand and view.
    """
    hands = {}
    for hand in dict.fromkeys(row["hand"] for row in rows):
        own = [row for row in rows if row["hand"] == hand]
        whole_held = {row["case"]: row["whole"] for row in own}
        hands[hand] = {
            "whole_mesh": _share(list(whole_held.values())),
            "cloud": _share([row["held"] for row in own]),
            "cloud_by_margin_alone": _share([row["by_margin"] for row in own]),
            "where_the_whole_mesh_held": _share([row["held"] for row in own if row["whole"]]),
            "objects": {
                case: {"whole": held, **_share([row["held"] for row in own if row["case"] == case])}
                for case, held in whole_held.items()
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
                **_share([row["held"] for row in answered if _in_class(row["trust"], low, high)]),
            }
            for low, high in pairwise(TRUST_LIMITS)
        ],
        "seen_share": mean(row["seen_share"] for row in answered),
        "contacts_seen": mean(sum(row["contacts_seen"]) / len(row["contacts_seen"]) for row in answered),
        "refused": [
            {"hand": row["hand"], "case": row["case"], "view": row["view"], "reason": row["refused"]}
            for row in rows
            if "refused" in row
        ],
    }


def _in_class(trust: float, low: float, high: float) -> bool:
    return low <= trust < high or trust == high == TRUST_LIMITS[-1]


def _share(held: Sequence[bool]) -> dict[str, Any]:
    count, good = len(held), sum(held)
    return {
        "tested": count,
        "held": good,
        "share": good / count if count else None,
        "interval": wilson(good, count),
    }


def _shape(rows: Sequence[dict[str, Any]], method: str) -> dict[str, Any]:
    # The surface of a view does not depend on the hand, so each view counts once.
    shapes = {(row["case"], row["view"]): row["shapes"][method] for row in rows if "shapes" in row}
    return {
        "views": len(shapes),
        **{name: mean(shape[name] for shape in shapes.values()) for name in ("iou", "chamfer")},
    }


def cloud_tables(document: dict[str, Any]) -> list[Table]:
    """The figures as tables."""
    columns = ("whole_mesh", "cloud", "where_the_whole_mesh_held", "cloud_by_margin_alone")
    return [
        Table(
            caption="Answers that held in the six-direction test of the true object (95 % interval)",
            columns=("hand", "whole mesh", "cloud", "cloud, where mesh held", "cloud, margin alone"),
            rows=tuple(
                (hand, *(_share_text(own[name]) for name in columns))
                for hand, own in document["hands"].items()
            ),
        ),
        Table(
            caption="Agreement of the completed with the true object: shared volume, mean surface distance",
            columns=("completion of the far side", "views", "IoU", "mm"),
            rows=tuple(
                (
                    _METHODS[method],
                    own["views"],
                    own["iou"],
                    None if own["chamfer"] is None else f"{1000 * own['chamfer']:.1f}",
                )
                for method, own in document["shapes"].items()
            ),
        ),
        Table(
            caption="Answers that held, by trust",
            columns=("trust", "held"),
            rows=tuple(
                (f"{row['from']:.1f} to {row['to']:.1f}", _share_text(row)) for row in document["trust"]
            ),
        ),
        Table(
            caption="Objects",
            columns=("hand", "object", "whole mesh", "views held"),
            rows=tuple(
                (hand, case, "held" if one["whole"] else "lost", f"{one['held']} of {one['tested']}")
                for hand, own in document["hands"].items()
                for case, one in own["objects"].items()
            ),
        ),
    ]


def _share_text(share: dict[str, Any]) -> str | None:
    if not share["tested"]:
        return None
    low, high = share["interval"]
    return f"{share['held']} of {share['tested']}, {share['share']:.0%} ({low:.0%}-{high:.0%})"


def write_cloud_report(document: dict[str, Any], folder: Path) -> list[Path]:
    """Write report.json, report.md and report.html; return their paths.

    Raises:
        EnvironmentFailure: A file cannot be written.
    """
    run = document["run"]
    chapters = [Chapter(title="Results", blocks=tuple(cloud_tables(document)))]
    if document["refused"]:
        refused = (
            f"{one['hand']}, {one['case']}, view {one['view']}: {one['reason']}"
            for one in document["refused"]
        )
        chapters.append(Chapter(title="Views without an answer", blocks=(Bullets(items=tuple(refused)),)))
    report = Report(
        title="Grasps on partial views",
        preface=(
            f"preshape {document['version']}; {run['views']} views of each object, noise "
            f"{1000 * run['noise']:g} mm, seed {run['seed']}, task {run['task']}.",
        ),
        chapters=tuple(chapters),
    )
    return write_report(folder, report, document)
