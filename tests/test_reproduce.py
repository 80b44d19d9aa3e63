"""``preshape reproduce`` in its quick form: the numbers, the report, and stopping and going on."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import pytest
from scipy.stats import binomtest

from preshape.exceptions import EnvironmentFailure, InputError
from preshape.hiis.fuzzy import tfvadi
from preshape.physics import measures
from preshape.studies import (
    EXPERIMENTS,
    ReportResult,
    fig_14,
    fig_15,
    fig_16,
    figs_11_13,
    learning_study,
    odd_cases,
    printed,
    run_all,
    table_4,
)
from preshape.studies.experiment import Section
from preshape.studies.setup import Setup

STOP_AT = f"odd cases: experiment {odd_cases.QUICK_EACH + 4} of"
"""In the middle of the second session."""


class Recorder:
    """A progress callback that notes everything down, and stops the work at a label."""

    def __init__(self, stop_at: str | None = None) -> None:
        self.fractions: list[float] = []
        self.labels: list[str] = []
        self.stop_at = stop_at

    def __call__(self, fraction: float, label: str) -> None:
        self.fractions.append(fraction)
        self.labels.append(label)
        if self.stop_at and label.startswith(self.stop_at):
            raise KeyboardInterrupt


class Run:
    """A quick run that was interrupted once and then finished."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.first = Recorder(stop_at=STOP_AT)
        with pytest.raises(KeyboardInterrupt):
            run_all(out, quick=True, progress=self.first)
        self.before = {path.name: path.stat().st_mtime_ns for path in out.glob("*.json")}
        self.second = Recorder()
        self.result: ReportResult = run_all(out, quick=True, progress=self.second)

    def data(self, name: str) -> dict[str, Any]:
        return json.loads((self.out / f"{name}.json").read_text(encoding="utf-8"))["data"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return Run(tmp_path_factory.mktemp("reproduce") / "made" / "anew")


def without_times(data: Any) -> Any:
    """The measured values that must follow from the seed."""
    if isinstance(data, dict):
        return {key: without_times(x) for key, x in data.items() if key != "seconds"}
    return [without_times(x) for x in data] if isinstance(data, list) else data


def test_an_interrupted_run_goes_on_where_it_stopped(run: Run) -> None:
    names = list(EXPERIMENTS)
    finished = names[: names.index("odd_cases")]
    assert sorted(run.before) == sorted(f"{name}.json" for name in finished)
    assert run.result.reused == tuple(finished)
    assert run.result.measured == tuple(names[len(finished) :])
    for name, when in run.before.items():
        assert (run.out / name).stat().st_mtime_ns == when
    redone = [label for label in run.second.labels if label.startswith("odd cases: experiment")]
    assert redone[0].startswith(f"odd cases: experiment {odd_cases.QUICK_EACH + 1} of")
    assert len(redone) == odd_cases.QUICK_EACH
    assert not list(run.out.glob("*.part"))


def test_resuming_changes_no_number(run: Run, tmp_path: Path) -> None:
    whole = odd_cases.measure(Setup(0, quick=True), tmp_path / "part", lambda fraction, label: None)
    assert without_times(json.loads(json.dumps(whole))) == run.data("odd_cases")


def test_the_numbers_follow_from_the_seed(run: Run, tmp_path: Path) -> None:
    setup = Setup(0, quick=True)
    for experiment in (figs_11_13.FIG_11, fig_14.FIG_14, fig_16.FIG_16, learning_study.LEARNING):
        again = experiment.measure(setup, tmp_path / "part", lambda fraction, label: None)
        assert without_times(json.loads(json.dumps(again))) == without_times(run.data(experiment.name))


def test_progress_rises_to_one(run: Run) -> None:
    for recorder in (run.first, run.second):
        assert all(0 <= x <= 1 for x in recorder.fractions)
        assert recorder.fractions == sorted(recorder.fractions)
    assert run.second.fractions[-1] == 1.0
    assert all(run.second.labels)


def test_golden_wrenches_of_fig_14(run: Run) -> None:
    rows = run.data("fig14")["rows"]
    wanted = [(0.90, 1.0, -0.20, -0.04, 0.90, 0.07), (1.35, 1.0, -0.30, -0.06, 0.80, 0.10)]
    for row, wrench, theirs in zip(rows, wanted, printed.FIG_14, strict=False):
        assert row["aimed"]["wrench"] == pytest.approx(wrench, abs=0.006)
        assert row["aimed"]["wrench"] == pytest.approx(theirs.wrench, abs=0.12)
        assert row["typed"] == pytest.approx(float(tfvadi(printed.Q1, theirs.wrench)), abs=1e-9)
    assert rows[0]["typed"] == pytest.approx(3.967, abs=5e-4)
    assert all(row["box"]["answer"]["plane"] == 5 for row in rows)
    section = fig_14._present(run.data("fig14"))
    assert not [x for x in section.remarks if x.startswith("Row 3")]
    assert "Row 3 of the paper is left out" in section.text[1]


def test_modes_of_fig_15(run: Run) -> None:
    rows = run.data("fig15")["rows"]
    assert [row["mode"] for row in rows] == [0, 1, 2, 2]
    first, second, third, _ = (row.threshold for row in printed.FIG_15)
    assert first <= rows[0]["answer"]["tfvadi"] < second <= rows[1]["answer"]["tfvadi"] < third
    assert rows[0]["answer"]["plane"] == rows[1]["answer"]["plane"] == rows[2]["estimated_plane"]
    assert rows[0]["answer"]["tfvadi"] == rows[0]["estimated_match"]
    assert rows[2]["recognition"] >= 5.0
    assert len({str(row["q"]) for row in rows}) == 1
    assert len(fig_15._present(run.data("fig15")).tables[0].rows) == 4


def test_golden_values_of_fig_16(run: Run) -> None:
    data = run.data("fig16")
    assert data["golden"] == pytest.approx([3.700, 3.9714, 2.800, 4.200, 3.967], abs=5e-4)
    typed = [row["typed_kept"] for row in data["rows"]]
    assert [row.label for row, match in zip(fig_16.ROWS, typed, strict=True) if match < 3] == ["ZERO narrow"]


def test_table_4_in_its_quick_form_ends_before_the_errors_of_the_paper(run: Run) -> None:
    data = run.data("table4")
    (only,) = data["runs"]
    assert only["reached"] == [None, None, None]
    assert printed.ERRORS[0] < only["error"] < 0.8 * only["curve"][0][1]
    assert only["curve"][0][0] == 1
    headline = table_4._present(data).headline
    assert headline.startswith("5.0e-04 is reached by 0 of 1 at rate 0.04 within 500 epochs; by the paper's")


def test_sentences_on_table_4_follow_the_numbers() -> None:
    runs = [
        {"rate": 0.04, "seed": i, "reached": [epochs for epochs, _ in run], "curve": []}
        for i, run in enumerate(printed.TABLE_4)
    ]
    data = {
        "runs": runs, "limit": 50_000, "seconds": 1.0, "tasks": 48, "samples": 48,
        "trainer": {"iterations": 60, "error": 4e-4, "seconds": 0.1},
    }  # fmt: skip
    section = table_4._present(data)
    assert section.remarks == ()
    assert "3 of 3 at rate 0.04, after 30240 (28032 to 38184) epochs" in section.headline
    rows = {row[0]: row[1:] for row in section.tables[0].rows}
    assert rows["its median / the paper's"] == ("1.00", "1.00", "1.00")
    assert rows["paper, median (range)"] == rows["preshape, rate 0.04, median (range)"]
    for slow in runs[:2]:
        slow["reached"][2] = None
    section = table_4._present(data)
    assert "1 of 3 at rate 0.04, after 38184 (38184 to 38184) epochs" in section.headline
    assert [remark.split(":")[0] for remark in section.remarks] == [
        "At rate 0.04, these medians are outside the range of the paper",
        "At rate 0.04, 2 of 3 networks do not reach 5.0e-04 within 50000 epochs.",
    ]


def test_odd_cases_are_counted_once(run: Run) -> None:
    rows = run.data("odd_cases")["rows"]
    assert [row["number"] for row in rows] == list(range(1, 21))
    assert all((row["hand"] is not None) == (row["outcome"] == "answer") for row in rows)
    assert all(row["scale"] in odd_cases.SCALES for row in rows)
    assert not [row for row in rows if row["outcome"] == odd_cases.REFUSED]


@pytest.mark.parametrize(("part", "whole"), [(0, 10), (1, 19), (75, 500), (10, 10)])
def test_wilson_interval(part: int, whole: int) -> None:
    wanted = binomtest(part, whole).proportion_ci(0.95, method="wilson")
    assert measures.wilson(part, whole) == pytest.approx((wanted.low, wanted.high), abs=1e-6)


def test_the_report_holds_everything(run: Run) -> None:
    markdown = run.result.markdown.read_text(encoding="utf-8")
    html = run.result.html.read_text(encoding="utf-8")
    for name, title in EXPERIMENTS.items():
        assert f"\n## {title}\n" in markdown
        assert f'<section id="{name}">' in html
    linked = re.findall(r"\]\((figures/[^)]+\.png)\)", markdown)
    files = sorted(path.relative_to(run.out).as_posix() for path in run.out.glob("figures/*.png"))
    assert sorted(linked) == files
    embedded = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    assert sorted(map(base64.b64decode, embedded)) == sorted((run.out / name).read_bytes() for name in files)
    assert len(re.findall("<img ", html)) == len(embedded)
    bare = re.sub(r"base64,[^\"]+", "", html)
    assert not re.search(r"https?:|//|@import|url\(", bare)
    assert re.search("prefers-color-scheme: ?dark", bare)
    assert "seed 0" in markdown
    assert str(run.out) not in markdown


def _as_printed(figure: tuple[printed.TaskRow, ...]) -> dict[str, Any]:
    """What would be measured if everything were as the paper prints it."""
    rows = []
    for case in figure:
        grasp = {"plane": case.plane, "value": case.value, "tfvadi": case.tfvadi}
        rows.append(
            {
                "mode": case.mode, "status": "answer", "answer": None if case.mode == 2 else grasp,
                "estimated_plane": case.plane, "estimated_match": None, "searched": None, "best": grasp,
                "recognition": case.tfvadi, "steps": [],
            }
        )  # fmt: skip
    return {
        "object": "cube",
        "extents": [1.0, 1.0, 1.0],
        "cases": rows,
        "taught_afterwards": "",
        "others": [],
    }


def _sections(figure: tuple[printed.TaskRow, ...], data: dict[str, Any]) -> Section:
    present = {
        id(printed.FIG_11): figs_11_13.FIG_11,
        id(printed.FIG_12): figs_11_13.FIG_12,
        id(printed.FIG_13): figs_11_13.FIG_13,
    }
    return present[id(figure)].present(data)


@pytest.mark.parametrize("figure", [printed.FIG_11, printed.FIG_12, printed.FIG_13])
def test_sentences_follow_the_numbers(figure: tuple[printed.TaskRow, ...]) -> None:
    data = _as_printed(figure)
    assert _sections(figure, data).remarks == ()
    data["cases"][1]["answer"] = {**data["cases"][1]["answer"], "plane": 12}
    (sentence,) = _sections(figure, data).remarks
    assert sentence.startswith(f"Case 2: the paper has plane {figure[1].plane}; preshape has plane 12.")


def test_other_settings_and_damaged_files_are_measured_anew(tmp_path: Path) -> None:
    def go(**options: Any) -> ReportResult:
        return run_all(
            tmp_path, only=["contradictions"], quick=True, progress=lambda fraction, label: None, **options
        )

    assert go().measured == ("contradictions",)
    assert go().reused == ("contradictions",)
    assert go(seed=1).measured == ("contradictions",)
    assert go(seed=1, resume=False).measured == ("contradictions",)
    file = tmp_path / "contradictions.json"
    file.write_text(file.read_text(encoding="utf-8")[:40], encoding="utf-8")
    assert go(seed=1).measured == ("contradictions",)


def test_what_is_asked_for_must_exist(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no experiment 'fig99'; known: table4, fig11"):
        run_all(tmp_path, only=["fig99"], progress=lambda fraction, label: None)
    with pytest.raises(InputError, match="the seed must be 0 or more"):
        run_all(tmp_path, seed=-1, progress=lambda fraction, label: None)
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(EnvironmentFailure, match="cannot create the folder"):
        run_all(file, only=["contradictions"], progress=lambda fraction, label: None)
