"""Table 4: epochs and time of plain back-propagation on the first training set (§3.5)."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from ..hiis.estimator import LAYERS
from ..hiis.learning import seed_tasks, training_set
from ..hiis.training import back_propagation, mean_square_error, train
from ..report import Cell, Figure, Table
from ..types import Array
from . import printed
from .experiment import Experiment, Progress, Section, joined
from .plots import OURS, PAPER, QUIET, THIRD, PlotCanvas
from .setup import Data, Setup

RATE, SLOW_RATE = 0.5, 0.02
"""Learning rates [C]; the paper gives none."""

LIMIT, SLOW_LIMIT = 10_000, 15_000
"""Largest number of epochs of a run at each rate."""

_FIRST_EPOCHS = (1, 2, 5, 10, 20, 50)


def _measure(setup: Setup, part: Path, progress: Progress) -> Data:
    controller = setup.prepare(setup.system(), "cube").controller
    x, y = training_set(controller.experiences, setup.hand.u)
    targets = printed.ERRORS[:1] if setup.quick else printed.ERRORS
    planned = [(RATE, LIMIT, setup.seed + i) for i in range(1 if setup.quick else 3)]
    if not setup.quick:
        planned += [(SLOW_RATE, SLOW_LIMIT, setup.seed + i) for i in range(3)]
    runs = []
    for k, (rate, limit, seed) in enumerate(planned):
        label = f"back-propagation, run {k + 1} of {len(planned)}"

        def tell(fraction: float, state: str = "", *, k: int = k, label: str = label) -> None:
            progress((k + fraction) / len(planned), f"{label}{state}")

        tell(0.0)
        runs.append(_run(x, y, targets, rate, limit, seed, tell))
    start = time.perf_counter()
    trained = train(x, y, seed=setup.seed)
    return {
        "tasks": len(seed_tasks()),
        "samples": len(x),
        "targets": list(targets),
        "runs": runs,
        "trainer": {
            "iterations": trained.epochs,
            "error": mean_square_error(trained, x, y),
            "seconds": time.perf_counter() - start,
        },
    }


def _run(
    x: Array, y: Array, targets: tuple[float, ...], rate: float, limit: int, seed: int, tell: Progress
) -> Data:
    """One run of back-propagation with its learning curve."""
    curve: dict[int, float] = {}

    def record(epoch: int, error: float) -> None:
        curve[epoch] = error
        tell(epoch / limit, f": epoch {epoch}, error {error:.1e}")

    start = time.perf_counter()
    reached, weights = back_propagation(
        x, y, targets=targets, seed=seed, rate=rate, max_epochs=limit, progress=record
    )
    seconds = time.perf_counter() - start
    # Errors are recorded every hundred epochs, so the beginning is run again in shorter steps.
    for n in (n for n in _FIRST_EPOCHS if n < weights.epochs):
        _, first = back_propagation(x, y, targets=(0.0,), seed=seed, rate=rate, max_epochs=n)
        curve.setdefault(n, first.mean_square_error)
    curve[weights.epochs] = weights.mean_square_error
    return {
        "rate": rate,
        "limit": limit,
        "seed": seed,
        "reached": reached,
        "epochs": weights.epochs,
        "error": weights.mean_square_error,
        "curve": [[n, curve[n]] for n in sorted(curve)],
        "seconds": seconds,
    }


def _epochs_text(epochs: int | None, run: Data) -> str:
    """Epochs and time as text; every epoch is assumed to take the same time."""
    if epochs is None:
        return f"not within {run['limit']}"
    return f"{epochs} ({run['seconds'] * epochs / run['epochs']:.2g} s)"


def _present(data: Data) -> Section:
    rows: list[tuple[Cell, ...]] = [
        (f"paper, run {i}", *(f"{epochs} ({seconds} s)" for epochs, seconds in run))
        for i, run in enumerate(printed.TABLE_4, start=1)
    ]
    for run in data["runs"]:
        cells = [_epochs_text(epochs, run) for epochs in run["reached"]]
        cells += ["not run"] * (len(printed.ERRORS) - len(cells))
        rows.append((f"preshape, rate {run['rate']:g}, seed {run['seed']}", *cells))
    trainer = data["trainer"]
    rows.append(
        (
            "preshape, default trainer (L-BFGS)", None, None,
            f"{trainer['iterations']} iterations to {trainer['error']:.1e} ({trainer['seconds']:.2g} s)",
        )
    )  # fmt: skip
    fast = [run for run in data["runs"] if run["rate"] == RATE]
    reached = [run["reached"][-1] for run in fast if run["reached"][-1] is not None]
    theirs = [run[len(data["targets"]) - 1][0] for run in printed.TABLE_4]
    after = f" after {_range(reached)} epochs" if reached else ""
    return Section(
        headline=f"{len(reached)} of {len(fast)} runs at rate {RATE:g} reach "
        f"{data['targets'][-1]:.1e}{after}; the paper's runs after {_range(theirs)}.",
        text=(
            f"A {'-'.join(str(n) for n in LAYERS)} network with logistic activations is trained by plain "
            "back-propagation, sample by sample and without momentum. The training set has the Q1- and "
            f"Q2-type tasks of the twelve planes on the cube, with both signs: {data['tasks']} tasks, "
            f"{data['samples']} different ones. The learning rate is {RATE:g}; the paper gives neither its "
            "rate nor its training set. Times are shares of the whole run's.",
            "Everything else in preshape uses the trainer of the last line, which reaches the same error.",
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
        remarks=tuple(_disagreements(data)),
    )


def _disagreements(data: Data) -> Iterator[str]:
    k = len(data["targets"]) - 1
    theirs = [run[k][0] for run in printed.TABLE_4]
    yield f"All runs of the paper reach {printed.ERRORS[k]:.1e}, after {min(theirs)} to {max(theirs)} epochs."
    for rate in sorted({run["rate"] for run in data["runs"]}, reverse=True):
        runs = [run for run in data["runs"] if run["rate"] == rate]
        reached = [run["reached"][k] for run in runs if run["reached"][k] is not None]
        stuck = [run for run in runs if run["reached"][k] is None]
        sentence = f"At rate {rate:g}, {len(reached)} of {len(runs)} runs of preshape reach it"
        if reached:
            ratio = sum(theirs) / len(theirs) / (sum(reached) / len(reached))
            sentence += f", after {_range(reached)} epochs, {_times(ratio)}"
        if stuck:
            bits = data["samples"] * LAYERS[-1]
            errors = joined([f"{run['error']:.1e}" for run in stuck])
            wrong = joined([f"{run['error'] * bits:.1f}" for run in stuck])
            sentence += (
                f"; {len(stuck)} stayed at an error of {errors} for {stuck[0]['limit']} epochs, which is as "
                f"much as {wrong} of {bits} output bits saturated at the wrong value"
            )
        yield f"{sentence}."
    yield (
        "The number of epochs depends on the learning rate and the training set, which the paper does not "
        "give. It does not mention failed runs either."
    )


def _range(numbers: list[int]) -> str:
    low, high = min(numbers), max(numbers)
    return str(low) if low == high else f"{low} to {high}"


def _times(ratio: float) -> str:
    return f"{ratio:.0f} times fewer" if ratio >= 1 else f"{1 / ratio:.1f} times as many"


def _draw(data: Data, path: Path) -> None:
    with PlotCanvas(path, size=(8.0, 4.2)) as axes:
        for rate, colour, style in ((RATE, OURS, "-"), (SLOW_RATE, THIRD, "--")):
            runs = [run for run in data["runs"] if run["rate"] == rate]
            for i, run in enumerate(runs):
                label = f"preshape, rate {rate:g}" if i == 0 else None
                axes.plot(*zip(*run["curve"], strict=True), style, color=colour, lw=1.4, label=label)
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
        axes.legend(loc="upper right")


TABLE_4 = Experiment(
    name="table4", title="Table 4: training by back-propagation",
    version=1, cost=120, measure=_measure, present=_present,
)  # fmt: skip
