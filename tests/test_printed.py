"""Every number that ``studies.printed`` takes from the paper, against the words of its scan."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from preshape.studies import printed

SCAN: dict[str, tuple[tuple[str, str], ...]] = {
    "Q1": (
        ("X Y 1.00] 1.00] 0.1/ 0.05/ 0.8 0.05", "1.00 1.00 0.1 0.05 0.8 0.05"),
    ),
    "Q2": (
        ("X Y 1.00| 1.00] 0.1 0.8 | 0.05| 0.05", "1.00 1.00 0.1 0.8 0.05 0.05"),
    ),
    "ERRORS": (
        ("EMS=2.5e-3 EMS=1.0e-3 EMS=5.0e-4", "2.5e-3 1.0e-3 5.0e-4"),
    ),
    "TABLE_4": (
        ("8424 72sec. |15864 |85sec |28032 |145sec", "8424 72 15864 85 28032 145"),
        ("6960 66 sec 13272 | 75sec |30240 |170sec", "6960 66 13272 75 30240 170"),
        ("9432 89 sec 17832 | 105sec | 38184 | 210 sec", "9432 89 17832 105 38184 210"),
    ),
    "FIG_11": (
        (
            "0.09 0.96 0.93 Plane: 7 1 . 4.09 0 0.20 0.83 0.24 | Value:0.1",
            "0.09 0.96 0.93 0.20 0.83 0.24 7 0.1 4.09 0",
        ),
        (
            "1.48 1.28 0.05 Plane: 6 2 ) 3.6 1 0.84 0.05 0.05 ] Value: 0.04",
            "1.48 1.28 0.05 0.84 0.05 0.05 6 0.04 3.6 1",
        ),
        (
            "1.04 092 111 Plane: 5 3 5.31 2 0.79 0.94 0.65 ] Value: 0.01",
            "1.04 092=0.92 111=1.11 0.79 0.94 0.65 5 0.01 5.31 2",
        ),
    ),
    "FIG_12": (
        (
            "1 1.31 0.76 0.11 Plane: 5 378 2 0.86 0.07 0.07 1 Value: 0.13 '"
            " … learned it successfully, in execution mode 3 with TFVADI 3.78.",
            "1.31 0.76 0.11 0.86 0.07 0.07 5 0.13 3.78 3",
        ),
        (
            "1.05 0.13 0.96 Plane: 10 26 . 0.84 0.05 0.05 Value: 0.02 '"
            " … performed execution of the task at exec mode 1, with TFVADI 3.6 indicating",
            "1.05 0.13 0.96 0.84 0.05 0.05 10 0.02 3.6 1",
        ),
        (
            "3 1.03 0.05 1.15 Plane: 9 40 0 | 005 005 091] Valueool |"
            " … at execution mode 0, demonstrating successful learning of the object, with TFVADI 4.0.",
            "1.03 0.05 1.15 005=0.05 005=0.05 091=0.91 9 ool=0.01 4.0 0",
        ),
    ),
    "FIG_13": (
        (
            "1.08 -1.0 0.05 Plane: 11 1 . 5.3 3 0.05 -0.8 0.05] Value: 0.01"
            " … occured with a relatively high matching degree TFVADI 5.89 due to",
            "1.08 -1.0 0.05 0.05 -0.8 0.05 11 0.01 5.89 3",
        ),
        (
            "1.01 097 0.05 Plane: 5 2 , 4.0 1 0.05 0.85 0.05 ] Value: 0.22",
            "1.01 097=0.97 0.05 0.05 0.85 0.05 5 0.22 4.0 1",
        ),
        (
            "0.75 0.1 0.96 Plane: 7 3 3.0 1 I 0.07 0.1 0.76 | Value: -0.03",
            "0.75 0.1 0.96 0.07 0.1 0.76 7 -0.03 3.0 1",
        ),
    ),
    "FIG_14": (
        (
            "1] Ka=0.3 Ko=0.2 3. 086 1.1 -0.22 Kn=1.0 Mn=0.9 1 -0.03 0.96 0.06",
            "0.3 0.2 1.0 0.9 none 086=0.86 1.1 -0.22 -0.03 0.96 0.06",
        ),
        (
            "2] Ka=0.45 Ko=0.3 3. 1.3 11 -0.27 Kn=1.0 Mn=08 ]71 0.06 086 0.11",
            "0.45 0.3 1.0 08=0.8 71=3.71 1.3 11=1.1 -0.27 0.06 086=0.86 0.11",
        ),
        (
            "3] Ka=0.55 Ko0=0.35 3. 2.1 1.2 -0.49 Kn=1.0 Mn=0.75 038 071 0.2",
            "0.55 0.35 1.0 0.75 none 2.1 1.2 -0.49 038=0.38 071=0.71 0.2",
        ),
    ),
    "FIG_14_PLANE": (("Plane=5 Value=0.01", "5"),),
    "FIG_14_VALUE": (("Plane=5 Value=0.01", "0.01"),),
    "FIG_15": (
        (
            "Plane: 7 0.27 1.0 2.7 3.0 3251 0 Value: -0.1 -0.11 0.82 1.2",
            "3.0 7 -0.1 3251=3.25 0 0.27 1.0 2.7 -0.11 0.82 1.2",
        ),
        (
            "Plane: 7 27 1.1 . 35 . 3770 1 0 0-36 Value: 0.09 -0.2 0.88 -0.61",
            "35=3.5 7 0.09 3770=3.77 1 0-36=0.36 1.1 27=2.7 -0.2 0.88 -0.61",
        ),
        (
            "Plane: 7 0.27 1.1 1.3 3.9 . 5741 2 Value: 0.08 -0.18 0.87 0.05",
            "3.9 7 0.08 5741=5.74 2 0.27 1.1 1.3 -0.18 0.87 0.05",
        ),
        (
            "Plane: 7 0.27 1.1 13 42 574 2 Value: 0.08 -0.18 0.87 0.05",
            "42=4.2 7 0.08 574=5.74 2 0.27 1.1 13=1.3 -0.18 0.87 0.05",
        ),
    ),
    "USUAL_WRENCH": (
        ("Plane: 5 1.3 1.1 -0.27", "1.3 1.1 -0.27"),
        ("Value: 0.01 3.98 0 -0.06 0.86 0.11", "-0.06 0.86 0.11"),
    ),
    "FIG_16": (
        (
            "Plane: 5 -0.48 0.82 -0.2 Zero*=[-0.08, -0.03, 0.03, 0.08] Value: 0.15 6.0 2 10 05 003",
            "-0.08 -0.03 0.03 0.08 2 5 0.15 6.0 -0.48 0.82 -0.2 10=1.0 05=0.5 003=0.03",
        ),
        (
            "Plane: 5 1.3 1.1 -0.27 Zero*=[-0.15, -0.08, 0.08, 0.15] Value: 0.01 3.98 0 -0.06 0.86 011",
            "-0.15 -0.08 0.08 0.15 0 5 0.01 3.98 1.3 1.1 -0.27 -0.06 0.86 011=0.11",
        ),
        (
            "Rwd-L*=[-0.4, -0.25, -0.15, -0.08] Plane: 5 1.3 1.1 -0.27 Fwd-L*=[ 0.08,0.15,0.25,04] |"
            " value:001 | 38| O | 006 o086 o011",
            "0.08 0.15 0.25 04=0.4 -0.4 -0.25 -0.15 -0.08 O=0 5 001=0.01 none"
            " 1.3 1.1 -0.27 006=-0.06 o086=0.86 o011=0.11",
        ),
        (
            "Rwd-L*=[-0.6, -0.4, -0.15, -0.05] Plane: 5 13 1.1 -0.27 Fwd-L*=[ 0.05, 0.15, 0.4,0.6 ]"
            " Value: 0.01 3.98 0 -0.06 0.86 0.11",
            "0.05 0.15 0.4 0.6 -0.6 -0.4 -0.15 -0.05 0 5 0.01 3.98 13=1.3 1.1 -0.27 -0.06 0.86 0.11",
        ),
        (
            "Rwd-M*=[-0.9, -0.7, -0.55, -0.35] Plane: 5 1.3 1.1 -0.27 Fwd-M*=[ 0.35,0.55,0.7,0.9] |"
            " value:0.01 | 38| © | 006 08 o011",
            "0.35 0.55 0.7 0.9 -0.9 -0.7 -0.55 -0.35 ©=0 5 0.01 none"
            " 1.3 1.1 -0.27 006=-0.06 08=0.86 o011=0.11",
        ),
        (
            "Rwd-M*=[-0.95, -0.85, -0.45, -0.35] | Plane: 5 13 1.1 -0.27 Fwd-M*=[ 0.35,0.45,0.85,095] |"
            " value:001 | **8| © | 006 o085 011",
            "0.35 0.45 0.85 095=0.95 -0.95 -0.85 -0.45 -0.35 ©=0 5 001=0.01 none"
            " 13=1.3 1.1 -0.27 006=-0.06 o085=0.86 011=0.11",
        ),
        (
            "Rwd-H*=[-1.2, -1.2, -0.9, -0.85] Plane:s | oo 13 1.1 -0.27 Fwd-H*=[ 0.85,0.9,1.2,1.2]"
            " Value: 0.01 ' -0.06 0.86 0.11",
            "0.85 0.9 1.2 1.2 -1.2 -1.2 -0.9 -0.85 oo=0 s=5 0.01 none"
            " 13=1.3 1.1 -0.27 -0.06 0.86 0.11",
        ),
    ),
    "ODD_RATE": (("around 15 % overall 500 experiments.", "15"),),
    "ODD_EXPERIMENTS": (("around 15 % overall 500 experiments.", "500"),),
}  # fmt: skip
"""Quotation and reading of each row of each constant.

Quotations are verbatim; " … " joins two places. A reading has the row's numbers in the constant's order, each
as it stands in the quotation. ``garbled=number`` reads a token that the scan garbles, and ``none`` stands for
a number that it loses.
"""


def read(quotation: str, reading: str) -> Iterator[float | None]:
    """The numbers of a reading, each of which must be in the quotation as a whole token."""
    for token in reading.split():
        scanned, _, number = token.rpartition("=")
        word = re.escape(scanned or number)
        if number != "none":
            assert re.search(rf"(?<![\d.-]){word}(?!\.?\d)", quotation), f"no {word} in {quotation!r}"
        yield None if number == "none" else float(number)


def numbers(constant: Any) -> Iterator[float | None]:
    """The numbers of a constant, in their order."""
    if isinstance(constant, dict):
        constant = tuple(constant.values())
    if isinstance(constant, tuple):
        for part in constant:
            yield from numbers(part)
    elif not isinstance(constant, str):
        yield constant


@pytest.mark.parametrize("name", SCAN)
def test_constants_are_as_the_paper_prints_them(name: str) -> None:
    wanted = [number for row in SCAN[name] for number in read(*row)]
    factor = 100 if name == "ODD_RATE" else 1  # the paper prints per cent
    assert [None if x is None else factor * x for x in numbers(getattr(printed, name))] == wanted


def test_every_constant_is_pinned() -> None:
    constants = {name for name in vars(printed) if name.isupper()}
    assert constants == {*SCAN, "GOLDEN"}


def test_membership_functions_have_the_papers_names() -> None:
    # The order of the sets in each row of SCAN: FWD before RWD, where both change.
    names = [tuple(row.changes) for row in printed.FIG_16]
    pairs = [(f"FWD-{size}", f"RWD-{size}") for size in "LLMMH"]
    assert names == [("ZERO",), ("ZERO",), *pairs]
    labels = ["ZERO narrow", "ZERO wide", "L narrow", "L wide", "M narrow", "M wide", "H narrow"]
    assert [row.label for row in printed.FIG_16] == labels


def test_golden_values_repeat_rows_of_figs_14_and_16() -> None:
    second = printed.FIG_14[1]
    # Fig. 16 prints the same net wrench with the other sign of Rx.
    assert tuple(map(abs, second.wrench)) == tuple(map(abs, printed.USUAL_WRENCH))
    narrow, wide, middle = (printed.FIG_16[i] for i in (0, 1, 5))
    wanted = (
        ("fig. 14 row 2", second.wrench, {}, second.tfvadi, 3.7),
        ("fig. 16, ZERO wide", wide.wrench, wide.changes, wide.tfvadi, 3.9714),
        ("fig. 16, ZERO narrow", printed.USUAL_WRENCH, narrow.changes, None, 2.8),
        ("fig. 16, M wide", printed.USUAL_WRENCH, middle.changes, None, 4.2),
        ("fig. 14 row 1", printed.FIG_14[0].wrench, {}, None, 3.967),
    )
    assert wanted == printed.GOLDEN


def test_quotations_are_in_the_paper(reference: Path) -> None:
    paper = reference.parent / "paper.txt"
    if not paper.exists():
        pytest.skip(f"there is no scan of the paper at {paper}")
    text = " ".join(paper.read_text(encoding="utf-8").split())
    quotations = [part for rows in SCAN.values() for row in rows for part in row[0].split(" … ")]
    assert [part for part in quotations if part not in text] == []
