"""Plots of the reports: a palette for colour-blind readers, a style, and a canvas that writes a PNG file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

PAPER, OURS, THIRD, FOURTH, QUIET = "#E69F00", "#0072B2", "#009E73", "#CC79A7", "#6B7480"
"""Colours of Okabe and Ito. The paper's numbers are orange and ours are blue in every plot."""

COMPONENTS = ("Tx", "Ty", "Tz", "Rx", "Ry", "Rz")

_STYLE = {
    "font.size": 10.5,
    "axes.titlesize": 11.5,
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E1E4E8",
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
}


class PlotCanvas:
    """A figure without a window; ``with PlotCanvas(path) as axes`` draws it and writes the PNG file.

    Args:
        path: The file.
        size: Width and height [inches].
        columns: Number of axes side by side.
        options: Further arguments of ``Figure.subplots``.
    """

    def __init__(
        self, path: Path, *, size: tuple[float, float] = (8.0, 3.8), columns: int = 1, **options: Any
    ) -> None:
        self.path, self.size, self.columns, self.options = path, size, columns, options

    def __enter__(self) -> Any:
        import matplotlib.style
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self._context = matplotlib.rc_context()
        self._context.__enter__()
        matplotlib.style.use(["default", _STYLE])
        self.figure = Figure(figsize=self.size, layout="constrained")
        FigureCanvasAgg(self.figure)
        return self.figure.subplots(1, self.columns, **self.options)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self.figure.savefig(self.path, dpi=150, format="png", metadata={"Software": None})
        finally:
            self._context.__exit__(None, None, None)


def grouped_bars(
    axes: Any,
    labels: Sequence[str],
    series: Sequence[tuple[str, Sequence[float | None], str]],
    *,
    notes: Sequence[Sequence[str]] = (),
    numbers: bool = True,
) -> None:
    """Draw groups of bars side by side; each bar has its height as text.

    Args:
        axes: Axes to draw on.
        labels: Label of each group.
        series: Name, height in each group (``None`` for no bar) and colour of each series.
        notes: For each series, a text above each of its bars.
        numbers: Whether the height is written at each bar.
    """
    width = 0.8 / len(series)
    for k, (name, heights, colour) in enumerate(series):
        at = [i + (k - (len(series) - 1) / 2) * width for i in range(len(labels))]
        axes.bar(at, [h or 0.0 for h in heights], width * 0.92, color=colour, label=name)
        for i, height in enumerate(heights if numbers else ()):
            text = "none" if height is None else f"{height:.2f}"
            if notes:
                text = f"{notes[k][i]}\n{text}"
            up = (height or 0.0) >= 0
            axes.annotate(
                text,
                (at[i], height or 0.0),
                (0, 2 if up else -2),
                textcoords="offset points",
                ha="center",
                va="bottom" if up else "top",
                fontsize=8.5,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.4},
                linespacing=1.15,
            )
    axes.set_xticks(range(len(labels)), labels)
    axes.grid(axis="x", visible=False)
