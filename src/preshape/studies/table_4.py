"""Table 4: epochs of the paper's back-propagation on the first training set (§3.5)."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from ..files import loads, write_json
from ..hiis.estimator import LAYERS
from ..hiis.learning import seed_tasks, training_set
from ..hiis.training import TARGETS, WITHIN, back_propagation, initial_weights, train
from ..report import Cell, Figure, Table
from ..types import Array, NetworkWeights
from . import printed
from .experiment import Experiment, Progress, Section, joined
from .plots import OURS, PAPER, QUIET, THIRD, PlotCanvas
from .setup import Data, Setup

RATES = (0.02, 0.04)
"""Learning rates; the paper gives none. Halving the rate about doubles the epochs: 0.02 comes nearest to the
paper's with the first lesson on the cube of 1.68 U, 0.04 did with the smaller cube of before [R]."""

NETWORKS, QUICK_NETWORKS = 6, 1
"""Networks at each rate."""

LIMIT, QUICK_LIMIT = 50_000, 500
"""Epochs after which training ends in any case."""

_BLOCK = 250
"""Epochs between two stored states."""
_RECORDED = {round(1.1**k) for k in range(114)}
"""Epochs of the learning curve: 1.1^k, up to the limit."""


def _measure(setup: Setup, part: Path, progress: Progress) -> Data:
    controller = setup.prepare(setup.system(), "cube").controller
    x, y = training_set(controller.experiences, setup.hand.u)
    networks, limit = (QUICK_NETWORKS, QUICK_LIMIT) if setup.quick else (NETWORKS, LIMIT)
    rates = RATES[:1] if setup.quick else RATES
    planned = [(rate, setup.seed + i) for rate in rates for i in range(networks)]
    measured = reach(x, y, printed.ERRORS, planned, limit=limit, part=part, progress=progress)
    start = time.perf_counter()
    trained = train(x, y, seed=setup.seed)
    return measured | {
        "tasks": len(seed_tasks()),
        "samples": len(x),
        "limit": limit,
        "trainer": {
            "iterations": trained.epochs,
            "error": trained.mean_square_error,
            "seconds": time.perf_counter() - start,
        },
    }


def reach(
    x: Array,
    y: Array,
    targets: Sequence[float],
    planned: Sequence[tuple[float, int]],
    *,
    limit: int,
    part: Path,
    progress: Progress,
) -> Data:
    """Train networks until each has reached all targets.

    The state is stored in ``part`` every 250 epochs, and training continues from a stored state.

    Args:
        x: (n, 13) inputs.
        y: (n, 9) bits.
        targets: Mean-square errors, largest first.
        planned: Each network's learning rate, and seed of its first weights and orders of the samples.
        limit: Number of epochs after which training ends in any case.
        part: File of the state.
        progress: Called with the completed share of the limit and the current step.

    Returns:
        ``seconds``, and ``runs`` with each network's rate and seed, the epoch at which it reached each target
        (``None`` if it did not), its last error and its learning curve.
    """
    state = _stored(part)
    if state is None:
        runs = [
            {
                "rate": rate, "seed": seed, "reached": [None] * len(targets), "error": 1.0, "curve": [],
                "network": _plain(initial_weights(seed, within=WITHIN)),
            }
            for rate, seed in planned
        ]  # fmt: skip
        state = {"epochs": 0, "seconds": 0.0, "runs": runs}
    while active := [run for run in state["runs"] if None in run["reached"] and state["epochs"] < limit]:
        error = max(run["error"] for run in active)
        label = f"back-propagation: epoch {state['epochs']}, {len(active)} networks, error {error:.1e}"
        progress(state["epochs"] / limit, label)
        start, done = time.perf_counter(), state["epochs"]
        epochs = min(_BLOCK, limit - done)
        networks = [_network(run["network"], len(x), done) for run in active]
        seeds, rates = [run["seed"] for run in active], [run["rate"] for run in active]
        errors, networks = back_propagation(x, y, networks, seeds=seeds, rates=rates, epochs=epochs)
        for run, course, network in zip(active, errors, networks, strict=True):
            for k, target in enumerate(targets):
                met = np.flatnonzero(course <= target)
                if run["reached"][k] is None and len(met):
                    run["reached"][k] = done + int(met[0]) + 1
            run["curve"] += [
                [done + i, float(e)] for i, e in enumerate(course, start=1) if done + i in _RECORDED
            ]
            run["error"], run["network"] = float(course[-1]), _plain(network)
        state["epochs"] += epochs
        state["seconds"] += time.perf_counter() - start
        write_json(part, state)
    for run in state["runs"]:
        del run["network"]
    return {"seconds": state["seconds"], "runs": state["runs"]}


def _stored(part: Path) -> Data | None:
    """The state of an interrupted training."""
    try:
        state: Data = loads(part.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return state


def _plain(w: NetworkWeights) -> list[Data]:
    return [part.tolist() for part in (w.w1, w.b1, w.w2, w.b2)]


def _network(plain: list[Data], samples: int, epochs: int) -> NetworkWeights:
    w1, b1, w2, b2 = (np.array(part) for part in plain)
    return NetworkWeights(
        w1=w1, b1=b1, w2=w2, b2=b2, mean_square_error=1.0, trained_on=samples, epochs=epochs
    )


def _present(data: Data) -> Section:
    limit, paper = data["limit"], [[run[k][0] for run in printed.TABLE_4] for k in range(len(printed.ERRORS))]
    ours = {rate: _columns(data, rate) for rate in dict.fromkeys(run["rate"] for run in data["runs"])}
    rows: list[tuple[Cell, ...]] = [
        (f"paper, run {i}", *(f"{epochs} ({seconds} s)" for epochs, seconds in run))
        for i, run in enumerate(printed.TABLE_4, start=1)
    ]
    rows.append(("paper, median (range)", *(_spread(column, limit) for column in paper)))
    for run in data["runs"]:
        label = f"preshape, rate {run['rate']:g}, seed {run['seed']}"
        rows.append((label, *(_epochs_text(epochs or math.inf, limit) for epochs in run["reached"])))
    for rate, columns in ours.items():
        ratios = [_ratio(column, theirs) for column, theirs in zip(columns, paper, strict=True)]
        rows += [
            (f"preshape, rate {rate:g}, median (range)", *(_spread(column, limit) for column in columns)),
            ("its median / the paper's", *(f"{r:.2f}" if r < math.inf else None for r in ratios)),
        ]
    trainer = data["trainer"]
    rows.append(
        (
            "preshape, default trainer (L-BFGS)", None, None,
            f"{trainer['iterations']} iterations to {trainer['error']:.1e} ({trainer['seconds']:.2g} s)",
        )
    )  # fmt: skip
    outcomes = []
    for rate, (*_, last) in ours.items():
        reached = [epochs for epochs in last if epochs < math.inf]
        after = f", after {_spread(reached, limit)} epochs" if reached else f" within {limit} epochs"
        outcomes.append(f"{len(reached)} of {len(last)} at rate {rate:g}{after}")
    return Section(
        headline=f"{printed.ERRORS[-1]:.1e} is reached by {joined(outcomes)}; by the paper's three networks "
        f"after {_spread(paper[-1], limit)}.",
        text=(
            f"{'-'.join(str(n) for n in LAYERS)} networks with logistic activations are trained by online "
            "back-propagation: one sample at a time, without momentum, to the outputs "
            f"{TARGETS[0]:g} and {TARGETS[1]:g} for the bits 0 and 1, from weights within ±{WITHIN:g}. The "
            "training set has the Q1- and Q2-type tasks of the twelve planes on the cube, with both signs: "
            f"{data['tasks']} tasks, {data['samples']} different ones. The paper gives none of these "
            "settings, nor its learning rate, to which the epochs are about inversely proportional. The "
            f"networks are trained side by side, in {data['seconds']:.0f} s for all.",
            "Everything else in preshape uses the trainer of the last line, which reaches the same error, "
            "against 0 and 1.",
        ),
        tables=(
            Table(
                caption="Epochs (time) to each mean-square error.",
                columns=("run", *(f"{error:.1e}" for error in printed.ERRORS)),
                rows=tuple(rows),
            ),
        ),
        figures=(
            Figure(
                file="figures/table4.png",
                caption="Mean-square error against epochs; the paper gives three points for each of its "
                "three runs.",
                draw=partial(_draw, data),
            ),
        ),
        remarks=tuple(_disagreements(ours, paper, limit)),
    )


def _columns(data: Data, rate: float) -> list[list[float]]:
    """Epochs to each error of the networks at a rate; infinite if it was not reached."""
    runs = [run["reached"] for run in data["runs"] if run["rate"] == rate]
    return [[epochs or math.inf for epochs in column] for column in zip(*runs, strict=True)]


def _disagreements(ours: dict[float, list[list[float]]], paper: list[list[int]], limit: int) -> Iterator[str]:
    """One sentence for each rate, on the errors at which it does not give the paper's epochs."""
    for rate, columns in ours.items():
        outside = [
            f"{_epochs_text(statistics.median(column), limit)} at {error:.1e}"
            for error, column, theirs in zip(printed.ERRORS, columns, paper, strict=True)
            if not min(theirs) <= statistics.median(column) <= max(theirs)
        ]
        if outside:
            yield f"At rate {rate:g}, these medians are outside the range of the paper: {joined(outside)}."
        if late := columns[-1].count(math.inf):
            yield (
                f"At rate {rate:g}, {late} of {len(columns[-1])} networks do not reach "
                f"{printed.ERRORS[-1]:.1e} within {limit} epochs."
            )


def _epochs_text(epochs: float, limit: int) -> str:
    return f"{epochs:.0f}" if epochs < math.inf else f"not within {limit}"


def _ratio(ours: Sequence[float], theirs: Sequence[float]) -> float:
    """Our median over the paper's."""
    return statistics.median(ours) / statistics.median(theirs)


def _spread(epochs: Sequence[float], limit: int) -> str:
    """Median and range."""
    median, first, last = (
        _epochs_text(n, limit) for n in (statistics.median(epochs), min(epochs), max(epochs))
    )
    return f"{median} ({first} to {last})"


def _draw(data: Data, path: Path) -> None:
    with PlotCanvas(path, size=(8.0, 4.2)) as axes:
        shown = set[float]()
        for run in data["runs"]:
            colour, style = (OURS, "-") if run["rate"] == RATES[0] else (THIRD, "--")
            label = None if run["rate"] in shown else f"preshape, rate {run['rate']:g}"
            shown.add(run["rate"])
            axes.plot(*zip(*run["curve"], strict=True), style, color=colour, lw=1.2, label=label)
        for i, points in enumerate(printed.TABLE_4):
            epochs = [point[0] for point in points]
            label = "paper" if i == 0 else None
            axes.plot(
                epochs, printed.ERRORS, "o-", color=PAPER, ms=5, lw=1, mec="black", mew=0.4, label=label
            )
        for error in printed.ERRORS:
            axes.axhline(error, color=QUIET, lw=0.8, ls=":")
            axes.annotate(
                f"{error:.1e}", (1, error), (2, 2), textcoords="offset points", fontsize=8.5, color=QUIET
            )
        axes.set(xscale="log", yscale="log", xlabel="epochs", ylabel="mean-square error", xlim=(0.9, 6e4))
        axes.legend(loc="lower left")


TABLE_4 = Experiment(
    name="table4", title="Table 4: training by back-propagation",
    version=2, cost=180, measure=_measure, present=_present,
)  # fmt: skip
