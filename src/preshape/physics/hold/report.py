"""Results of a run of holding tests: figures over all grasps, and every grasp as plain JSON values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, fields
from enum import Enum
from typing import Any, TypeVar

from ...exceptions import InputError
from ...types import value
from ..grasps import GraspSet
from ..measures import GraspGeometry, diversity, mean, wilson
from .six_directions import HoldResult, HoldStatus, ProbeResult

R = TypeVar("R")


@value
class HoldFigures:
    """Figures over a set of grasps; a figure that cannot be computed is ``None``.

    Attributes:
        grasps: Number of grasps in the set.
        tested: Number of grasps that could be tested.
        held: Number of grasps that held.
        rate: Share of the tested grasps that held.
        interval: 95 % interval of the rate (Wilson).
        penetrating: Number of grasps whose pregrasp penetrates object or hand too deeply; they count as lost.
        unstable: Number of grasps whose simulation became unstable; they count as lost.
        touching: Number of tested grasps with two or more parts (fingers, palm) in contact at the grasp pose.
        clean: Number of clean grasps (see :class:`~preshape.physics.hold.six_directions.HoldResult`).
        only_by_squeeze: Number of grasps that held only because of the squeeze.
        penetration: Mean penetration at the grasp pose [m].
        self_penetration: Mean self-penetration at the grasp pose [m].
        links: Mean number of links in contact at the grasp pose.
        contact_distance: Mean contact distance at the grasp pose [m].
        consistency: Mean consistency at the grasp pose [m].
        diversity: Diversity of the tested grasps; lower is more diverse.
        strength: Mean strength of the grasps for which the ladder was climbed.
    """

    grasps: int
    tested: int
    held: int
    rate: float | None
    interval: tuple[float, float] | None
    penetrating: int
    unstable: int
    touching: int
    clean: int
    only_by_squeeze: int
    penetration: float | None
    self_penetration: float | None
    links: float | None
    contact_distance: float | None
    consistency: float | None
    diversity: float | None
    strength: float | None


@value
class HoldReport:
    """The results of a run, in the order of the grasps.

    Attributes:
        grasps: The grasps as tested: with root poses and the protocol's errors.
        results: Result of each grasp.
        seconds: Time of this run [s]; results that an earlier run saved do not count.
    """

    grasps: GraspSet
    results: tuple[HoldResult, ...]
    seconds: float

    @property
    def faults(self) -> tuple[HoldResult, ...]:
        """The grasps that could not be tested."""
        return tuple(result for result in self.results if result.status is HoldStatus.INVALID)

    def figures(self, object_name: str | None = None) -> HoldFigures:
        """Figures over all grasps, or over those of one object."""
        results = [r for r in self.results if object_name in (None, r.object_name)]
        tested = [r for r in results if r.status is not HoldStatus.INVALID]
        shapes = [r.at_grasp for r in tested if r.at_grasp is not None]
        rows = [r.row for r in tested]
        held = sum(r.held for r in tested)
        return HoldFigures(
            grasps=len(results),
            tested=len(tested),
            held=held,
            rate=held / len(tested) if tested else None,
            interval=wilson(held, len(tested)),
            penetrating=sum(r.status is HoldStatus.PENETRATES for r in tested),
            unstable=sum(r.status is HoldStatus.UNSTABLE for r in tested),
            touching=sum(g.parts >= 2 for g in shapes),
            clean=sum(r.clean for r in tested),
            only_by_squeeze=sum(r.only_by_squeeze for r in tested),
            penetration=mean(g.penetration for g in shapes),
            self_penetration=mean(g.self_penetration for g in shapes),
            links=mean(g.links for g in shapes),
            contact_distance=mean(g.contact_distance for g in shapes),
            consistency=mean(g.consistency for g in shapes),
            diversity=diversity(self.grasps.grasp[rows], self.grasps.object_pose[rows]),
            strength=mean(r.strength for r in tested if r.strength is not None),
        )

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of the objects, in the order of their first grasps."""
        return tuple(dict.fromkeys(result.object_name for result in self.results))

    def to_json(self) -> dict[str, Any]:
        """Figures over all grasps and for each object, and every grasp, as plain JSON values."""
        return {
            "all": asdict(self.figures()),
            "objects": {name: asdict(self.figures(name)) for name in self.object_names},
            "grasps": [{**self._origin(result.row), **result_to_json(result)} for result in self.results],
        }

    def _origin(self, row: int) -> dict[str, Any]:
        if not self.grasps.origin:
            return {}
        file, file_row = self.grasps.origin[row]
        return {"file": file, "file_row": file_row}

    def fault_lines(self) -> tuple[str, ...]:
        """The grasps that could not be tested, a line for each file and reason; rows count from 0."""
        groups: dict[tuple[str, str], list[int]] = {}
        for result in self.faults:
            origin = self._origin(result.row)
            key = origin.get("file", ""), result.reason
            groups.setdefault(key, []).append(origin.get("file_row", result.row))
        return tuple(
            f"{file}{' ' if file else ''}row{'s' if len(rows) > 1 else ''} {_ranges(rows)}: {reason}"
            for (file, reason), rows in groups.items()
        )

    def raise_for_faults(self) -> None:
        """Raise an error if any grasp could not be tested.

        Raises:
            InputError: The message names all of them.
        """
        faults = self.faults
        if not faults:
            return
        tested = len(self.results) - len(faults)
        named = "; ".join(self.fault_lines())
        raise InputError(
            f"{len(faults)} of {len(self.results)} grasps could not be tested ({named}); "
            f"the other {tested} were"
        )


def _ranges(rows: list[int]) -> str:
    """Row numbers as text; neighbouring rows become a range.

    >>> _ranges([1, 2, 3, 7])
    '1-3, 7'
    """
    spans: list[list[int]] = []
    for row in rows:
        if spans and row == spans[-1][1] + 1:
            spans[-1][1] = row
        else:
            spans.append([row, row])
    return ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in spans)


def result_to_json(result: Any) -> dict[str, Any]:
    """A result of a holding or task test as plain JSON values; numbers keep every digit."""
    return {**asdict(result), "status": result.status.name.lower()}


def read_result(
    document: dict[str, Any], kind: type[R], status: type[Enum], **parts: Callable[[Any], Any]
) -> R:
    """The inverse of :func:`result_to_json`, for any kind of result.

    Args:
        document: The JSON values.
        kind: The result's class.
        status: The class of its status.
        parts: For each field that JSON holds in another form, a function that makes it; ``None`` stays.

    Raises:
        KeyError, TypeError, ValueError: The document is not such a result.
    """
    if set(document) != {field.name for field in fields(kind)}:  # type: ignore[arg-type]
        raise ValueError("the keys are not those of a result")
    found = {name: document[name] for name in parts}
    made = {name: None if found[name] is None else make(found[name]) for name, make in parts.items()}
    return kind(**{**document, **made, "status": status[document["status"].upper()]})


def result_from_json(document: dict[str, Any]) -> HoldResult:
    """A result of the holding test; see :func:`read_result`."""

    def probes(rows: Sequence[dict[str, Any]]) -> tuple[ProbeResult, ...]:
        return tuple(ProbeResult(**row) for row in rows)

    return read_result(
        document, HoldResult, HoldStatus, probes=probes, at_grasp=lambda shape: GraspGeometry(**shape)
    )


def numbers(row: Sequence[float]) -> tuple[float, ...]:
    """A row of numbers."""
    return tuple(float(x) for x in row)


def poses(rows: Sequence[Sequence[float]]) -> tuple[tuple[float, ...], ...]:
    """Rows of numbers: the poses of a planned grasp."""
    return tuple(map(numbers, rows))
