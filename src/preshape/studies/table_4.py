"""Table 4: epochs and time of plain back-propagation on the first training set (§3.5)."""

from __future__ import annotations

import time
from pathlib import Path

from ..hiis.estimator import LAYERS
from ..hiis.learning import seed_tasks, training_set
from ..hiis.training import back_propagation, mean_square_error, train
from . import printed
from .bench import Bench
from .plots import OURS, PAPER, QUIET, THIRD, Canvas
from .values import Cell, Data, Experiment, Picture, Progress, Section, Table, joined

RATE, SLOW_RATE = 0.5, 0.02
"""Learning rates [C]: the paper gives none."""

LIMIT, SLOW_LIMIT = 10_000, 15_000
"""Epochs at which a run is given up."""

_EARLY = (1, 2, 5, 10, 20, 50)


def _measure(bench: Bench, part: Path, progress: Progress) -> Data:
    controller = bench.controller()
    x, y = training_set(controller.experiences, bench.layout.u)
    targets = printed.ERRORS[:1] if bench.quick else printed.ERRORS
    plan = [(RATE, LIMIT, bench.seed + i) for i in range(1 if bench.quick else 3)]
    if not bench.quick:
        plan += [(SLOW_RATE, SLOW_LIMIT, bench.seed + i) for i in range(3)]
    runs = []
    for k, (rate, limit, seed) in enumerate(plan):
        label = f"back-propagation, run {k + 1} of {len(plan)}"

        curve: list[tuple[int, float]] = []

        def tell(
            epoch: int,
            error: float,
            *,
            k: int = k,
            limit: int = limit,
            label: str = label,
            curve: list[tuple[int, float]] = curve,
        ) -> None:
            curve.append((epoch, error))
            progress((k + epoch / limit) / len(plan), f"{label}: epoch {epoch}, error {error:.1e}")

        progress(k / len(plan), label)
        start = time.perf_counter()
        reached, weights = back_propagation(
            x, y, targets=targets, seed=seed, rate=rate, max_epochs=limit, progress=tell
        )
        seconds = time.perf_counter() - start
        # The callback comes every hundred epochs; the beginning is run again in short pieces.
        early = [
            (
                n,
                back_propagation(x, y, targets=(0.0,), seed=seed, rate=rate, max_epochs=n)[
                    1
                ].mean_square_error,
            )
            for n in (e for e in _EARLY if e < weights.epochs)
        ]
        points = dict([*early, *curve, (weights.epochs, weights.mean_square_error)])
        runs.append(
            {
                "rate": rate,
                "limit": limit,
                "seed": seed,
                "reached": reached,
                "epochs": weights.epochs,
                "error": weights.mean_square_error,
                "curve": [[n, points[n]] for n in sorted(points)],
                "seconds": seconds,
            }
        )
    start = time.perf_counter()
    trained = train(x, y, seed=bench.seed)
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


def _cell(epochs: int | None, run: Data) -> str:
    """Epochs and time; the time in proportion, as every epoch costs the same."""
    if epochs is None:
        return f"not within {run['limit']}"
    return f"{epochs} ({run['seconds'] * epochs / run['epochs']:.2g} s)"


def _present(data: Data) -> Section:
    rows: list[tuple[Cell, ...]] = [
        (f"paper, run {i}", *(f"{epochs} ({seconds} s)" for epochs, seconds in run))
        for i, run in enumerate(printed.TABLE_4, start=1)
    ]
    for run in data["runs"]:
        cells = [_cell(epochs, run) for epochs in run["reached"]]
        cells += ["not run"] * (len(printed.ERRORS) - len(cells))
        rows.append((f"preshape, rate {run['rate']:g}, seed {run['seed']}", *cells))
    trainer = data["trainer"]
    rows.append(
        (
            "preshape, the trainer for use (L-BFGS)", None, None,
            f"{trainer['iterations']} iterations to {trainer['error']:.1e} ({trainer['seconds']:.2g} s)",
        )
    )  # fmt: skip
    text = (
        f"A {'-'.join(str(n) for n in LAYERS)} network with logistic activations is trained by plain "
        "back-propagation, "
        f"sample by sample and without momentum, on the cube under the twelve planes' Q1- and Q2-type "
        "tasks with "
        f"both signs: {data['tasks']} tasks, {data['samples']} different ones. Learning rate {RATE:g}; "
        "the paper gives no rate, and its training "
        "set is not published. Times are shares of the whole run's.",
        "Everything else in preshape uses the trainer of the last line, which reaches the same error.",
    )
    fast = [run for run in data["runs"] if run["rate"] == RATE]
    met = [run["reached"][-1] for run in fast if run["reached"][-1] is not None]
    theirs = [run[len(data["targets"]) - 1][0] for run in printed.TABLE_4]
    after = f" after {_range(met)} epochs" if met else ""
    return Section(
        headline=f"{len(met)} of {len(fast)} runs at rate {RATE:g} reach {data['targets'][-1]:.1e}{after}; "
        f"the paper's after {_range(theirs)}.",
        text=text,
        tables=(
            Table(
                caption="Epochs (time) to each mean-square error.",
                columns=("run", *(f"{error:.1e}" for error in printed.ERRORS)),
                rows=tuple(rows),
            ),
        ),
        pictures=(
            Picture(
                name="table4",
                caption="Mean-square error against epochs; the paper gives three points of each of its "
                "three runs.",
                draw=lambda path: _draw(data, path),
            ),
        ),
        disagreements=tuple(_disagreements(data)),
    )


def _disagreements(data: Data) -> list[str]:
    k = len(data["targets"]) - 1
    error = printed.ERRORS[k]
    theirs = [run[k][0] for run in printed.TABLE_4]
    out = [f"To {error:.1e} the paper needs {min(theirs)} to {max(theirs)} epochs in all of its runs."]
    for rate in sorted({run["rate"] for run in data["runs"]}, reverse=True):
        runs = [run for run in data["runs"] if run["rate"] == rate]
        met = [run["reached"][k] for run in runs if run["reached"][k] is not None]
        stuck = [run for run in runs if run["reached"][k] is None]
        sentence = f"At rate {rate:g}, {len(met)} of {len(runs)} runs of preshape arrive"
        if met:
            ratio = sum(theirs) / len(theirs) / (sum(met) / len(met))
            sentence += f", after {_range(met)} epochs, {_times(ratio)}"
        if stuck:
            wrong = joined([f"{run['error'] * data['samples'] * LAYERS[-1]:.1f}" for run in stuck])
            sentence += (
                f"; {len(stuck)} stayed at an error of {joined([_error(run) for run in stuck])} for "
                f"{stuck[0]['limit']} epochs, as much as {wrong} saturated bits of "
                f"{data['samples'] * LAYERS[-1]} on the wrong side"
            )
        out.append(f"{sentence}.")
    out.append(
        "Epochs depend on the learning rate and on the training set, and neither is printed; nor is a "
        "run that failed."
    )
    return out


def _error(run: Data) -> str:
    return f"{run['error']:.1e}"


def _range(numbers: list[int]) -> str:
    low, high = min(numbers), max(numbers)
    return str(low) if low == high else f"{low} to {high}"


def _times(ratio: float) -> str:
    return f"{ratio:.0f} times fewer" if ratio >= 1 else f"{1 / ratio:.1f} times as many"


def _draw(data: Data, path: Path) -> None:
    with Canvas(path, size=(8.0, 4.2)) as axes:
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
