"""The figures of the critic's study: the fitted model, and how reliable it is on objects held out from it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from .._version import __version__
from ..closure.calibration import LIKELY, PickModel
from ..dataset.outcomes import Row
from ..exceptions import InputError
from ..files import write_json
from ..physics.measures import wilson
from ..report import Bullets, Chapter, Figure, Report, Table, write_report
from ..types import Array, BoolArray
from .index_statistics import area, calibration
from .plots import OURS, QUIET, PlotCanvas

FOLDS = 5
"""Number of groups of objects; each is judged by a model fitted to the others."""
BIN = 100
"""Least number of grips in a bin of the reliability diagram."""
SHRINKAGE = 0.5
"""Weight of the squares of the coefficients but the constant, in units of one grip's loss [C]."""
FLAT = 0.025
"""Height up to which objects are judged apart [m]."""

Figures = dict[str, Any]
"""Plain JSON values."""


def fitted(features: Array, picked: BoolArray) -> PickModel:
    """The model whose probabilities fit outcomes best: least logistic loss with small coefficients.

    Args:
        features: (n, 4) features of grips (:meth:`PickModel.features`).
        picked: (n,) whether each passed.

    Raises:
        InputError: There are no grips.
    """
    from scipy.optimize import minimize

    if not len(picked):
        raise InputError("there are no grips to fit the critic to")
    sign = np.where(picked, 1.0, -1.0)

    def loss(x: Array) -> tuple[float, Array]:
        told = sign * (features @ x)
        slope = -sign / (1.0 + np.exp(told))
        small = np.append(0.0, x[1:])
        total = np.logaddexp(0.0, -told).sum() + SHRINKAGE * small @ small
        return float(total), features.T @ slope + 2 * SHRINKAGE * small

    found = minimize(loss, np.zeros(features.shape[1]), jac=True, method="L-BFGS-B").x
    names = [f.name for f in fields(PickModel)]
    return PickModel(**{name: round(float(x), 3) for name, x in zip(names, found, strict=True)})


def critic_figures(rows: Sequence[Row]) -> Figures:
    """Everything that the report says, as plain JSON values.

    The objects are divided into ``FOLDS`` groups, by their sorted names. The grips on each group are judged
    by the model that was fitted to the others.

    Args:
        rows: The grips of :func:`~preshape.studies.critic_study.run_critic`.
    """
    picked = np.array([row["picked"] for row in rows], dtype=bool)
    usual, bold, whole, wrap, height = (
        np.array([row[name] for row in rows], dtype=np.float64)
        for name in ("usual", "bold", "whole", "wrap", "height")
    )
    features = PickModel.features(whole, wrap > 0, height)
    model = fitted(features, picked)
    names = sorted({row["object"] for row in rows})
    fold = np.array([names.index(row["object"]) % FOLDS for row in rows])
    told = np.zeros(len(rows))
    for k in range(FOLDS):
        held_out = fold == k
        if held_out.any() and not held_out.all():
            told[held_out] = fitted(features[~held_out], picked[~held_out]).probability(features[held_out])
        else:
            told[held_out] = model.probability(features[held_out])
    given = told >= LIKELY
    tiers = {
        "usual share of the friction": usual >= 1.0,
        "bold share": (usual < 1.0) & (bold >= 1.0),
        "whole friction": (bold < 1.0) & (whole >= 1.0) & given,
    }
    flat = height <= FLAT
    kinds = {
        "fingertips": (wrap == 0) & ~flat,
        "wraps": (wrap > 0) & ~flat,
        f"on objects up to {1e3 * FLAT:.0f} mm high": flat,
    }
    bins = [
        {**asdict(one), "predicted": float(told[(told >= one.low) & (told <= one.high)].mean())}
        for one in calibration(told, picked, max(1, min(10, len(rows) // BIN)))
    ]
    return {
        "version": __version__,
        "model": asdict(model),
        "grips": len(rows),
        "objects": len(names),
        "hands": sorted({row["hand"] for row in rows}),
        "picked": int(picked.sum()),
        "done": sum(bool(row["done"]) for row in rows),
        "statuses": dict(sorted(Counter(row["status"] for row in rows).items())),
        "bins": bins,
        "given": _share((~picked)[given]),
        "refused": _share((~given)[picked]),
        "area": asdict(area(told, picked)) if 0 < picked.sum() < len(picked) else None,
        "kinds": {
            name: {
                "picked": _share(picked[kind]),
                "failed_if_given": _share((~picked)[given & kind]),
                "refused_if_picked": _share((~given)[picked & kind]),
            }
            for name, kind in kinds.items()
        },
        "tiers": {name: _share(picked[tier]) for name, tier in tiers.items()},
    }


def _share(part: BoolArray) -> Figures:
    """How many of some grips, with the 95 % interval."""
    count, whole = int(part.sum()), len(part)
    return {"count": count, "of": whole, "interval": wilson(count, whole)}


def critic_tables(document: Figures) -> tuple[Table, ...]:
    """The reliability of the probabilities, the errors of the critic, and the model."""
    model = document["model"]
    return (
        Table(
            caption="Predicted and measured, on objects held out from the fit",
            columns=("predicted", "grips", "picked up", "95 % interval"),
            rows=tuple(
                (
                    f"{one['predicted']:.2f} ({one['low']:.2f}-{one['high']:.2f})",
                    one["count"],
                    f"{one['successes'] / one['count']:.2f}",
                    _interval(one["interval"]),
                )
                for one in document["bins"]
            ),
        ),
        Table(
            caption=f"A grip is given if its probability is at least {LIKELY:g}",
            columns=("grips", "picked up", "fail of those given", "refused of those picked up"),
            rows=(
                (
                    "all",
                    f"{document['picked']} of {document['grips']}",
                    _text(document["given"]),
                    _text(document["refused"]),
                ),
                *(
                    (
                        name,
                        _text(found["picked"]),
                        _text(found["failed_if_given"]),
                        _text(found["refused_if_picked"]),
                    )
                    for name, found in document["kinds"].items()
                ),
            ),
        ),
        Table(
            caption="Picked up, of the grips that a plan may give",
            columns=("what balances the load", "picked up"),
            rows=tuple((name, _text(found)) for name, found in document["tiers"].items()),
        ),
        Table(
            caption="The model: log odds",
            columns=tuple(f.name.replace("_", " ") for f in fields(PickModel)),
            rows=(tuple(f"{model[f.name]:+.2f}" for f in fields(PickModel)),),
        ),
    )


def _text(share: Figures) -> str:
    if not share["of"]:
        return "–"
    return (
        f"{share['count']} of {share['of']} ({share['count'] / share['of']:.1%}; "
        f"{_interval(share['interval'])})"
    )


def _interval(interval: Sequence[float] | None) -> str:
    return "–" if interval is None else f"{interval[0]:.2f}-{interval[1]:.2f}"


def findings(document: Figures) -> tuple[str, ...]:
    """What the study says, in sentences."""
    population = (
        f"{document['grips']} grips of {', '.join(document['hands'])}; objects: {document['objects']}. "
        f"Picked up: {document['picked']}, job done: {document['done']}."
    )
    if document["objects"] < FOLDS or document["grips"] < BIN or not document["area"]:
        few = (
            f"Nothing can be said of the critic: that takes {BIN} grips on {FOLDS} objects at least, some of "
            "which fail."
        )
        return population, few
    worst = max(
        (abs(one["predicted"] - one["successes"] / one["count"]) for one in document["bins"]), default=0.0
    )
    return (
        population,
        f"Predicted and measured shares differ by {worst:.3f} at most, in bins of {BIN} grips or more, on "
        "objects held out from the fit.",
        f"Of the grips that the critic gives, {_text(document['given'])} fail; of those that hold, "
        f"{_text(document['refused'])} are refused.",
    )


def draw_reliability(document: Figures, path: Path) -> None:
    """Draw the reliability diagram: measured share over predicted probability, with 95 % intervals."""
    with PlotCanvas(path, size=(5.6, 4.6)) as axes:
        axes.plot([0, 1], [0, 1], color=QUIET, linewidth=1.0, linestyle="--", label="as predicted")
        x = [one["predicted"] for one in document["bins"]]
        y = [one["successes"] / one["count"] for one in document["bins"]]
        spread = [
            [abs(one["interval"][k] - rate) for one, rate in zip(document["bins"], y, strict=True)]
            for k in (0, 1)
        ]
        axes.errorbar(
            x, y, yerr=spread, color=OURS, marker="o", linestyle="none", capsize=3, label="measured"
        )
        axes.axvline(LIKELY, color=QUIET, linewidth=0.8)
        axes.annotate("good enough", (LIKELY, 0.04), rotation=90, ha="right", color=QUIET, fontsize=9)
        axes.set_xlim(0, 1.01)
        axes.set_ylim(0, 1.01)
        axes.set_xlabel("predicted probability of a pick")
        axes.set_ylabel("share that was picked up")
        axes.legend(loc="upper left")


def write_critic_report(document: Figures, rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write report.md, report.html, report.json, grips.json and the diagram; return their paths.

    Raises:
        EnvironmentFailure: The folder cannot be written.
    """
    write_json(folder / "report.json", document)
    write_json(folder / "grips.json", {"format": "preshape critic rows 1", "rows": list(rows)})
    figure = Figure(
        file="reliability.png",
        caption="Predicted and measured",
        draw=lambda path: draw_reliability(document, path),
    )
    report = Report(
        title="How probably is a grip picked up?",
        chapters=(
            Chapter(
                title="The calibrated critic",
                blocks=(Bullets(items=findings(document)), *critic_tables(document), figure),
            ),
        ),
    )
    pages = write_report(folder, report)
    return [folder / "report.json", folder / "grips.json", folder / figure.file, *pages]
