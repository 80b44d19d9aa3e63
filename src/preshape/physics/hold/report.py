"""What a run of holding tests says: one line of JSON a grasp, and figures over the whole set."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import Any

from ...exceptions import InputError
from ...types import value
from ..grasps import GraspSet
from ..measures import GraspGeometry, diversity, mean, wilson
from .six_directions import HoldResult, HoldStatus, ProbeResult


@value
class HoldFigures:
    """Figures over a set of grasps; ``None`` where nothing could be tested.

    Attributes:
        grasps: in the set.
        tested: without those that could not be.
        held: that passed.
        rate: share of the tested that passed.
        interval: of that share, 95 % (Wilson).
        penetrating: whose pregrasp cuts too deep into object or hand; not held.
        unstable: whose simulation became unstable; not held.
        touching: with two parts (fingers, palm) in contact at the grasp pose, whether held or not.
        clean: that passed, touch at the grasp pose and cut in less than a millimetre.
        only_by_squeeze: that passed without touching at the grasp pose.
        penetration: mean at the grasp pose [m], as the next four.
        self_penetration: mean [m].
        links: mean number of links in contact.
        contact_distance: mean [m].
        consistency: mean difference of the farthest and the nearest finger [m].
        diversity: share of the first principal axis of the grasps tested; lower is more diverse.
        strength: mean of the ladder's last factor held, where it was climbed.
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
        grasps: as tested: root poses, with the protocol's errors.
        results: one of each grasp.
        seconds: that this run took, without what it found done.
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
        rows = [r for r in self.results if object_name in (None, r.object_name)]
        tested = [r for r in rows if r.status is not HoldStatus.INVALID]
        shapes = [r.at_grasp for r in tested if r.at_grasp is not None]
        at = [r.row for r in tested]
        held = sum(r.held for r in tested)
        return HoldFigures(
            grasps=len(rows),
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
            diversity=diversity(self.grasps.grasp[at], self.grasps.object_pose[at]),
            strength=mean(r.strength for r in tested if r.strength is not None),
        )

    @property
    def object_names(self) -> tuple[str, ...]:
        """The objects, in the order in which they first come."""
        return tuple(dict.fromkeys(result.object_name for result in self.results))

    def to_json(self) -> dict[str, Any]:
        """Figures over all and for each object, and every grasp, as plain JSON values."""
        return {
            "all": asdict(self.figures()),
            "objects": {name: asdict(self.figures(name)) for name in self.object_names},
            "grasps": [{**self._place(result.row), **result_to_json(result)} for result in self.results],
        }

    def _place(self, row: int) -> dict[str, Any]:
        if not self.grasps.origin:
            return {}
        file, file_row = self.grasps.origin[row]
        return {"file": file, "file_row": file_row}

    def fault_lines(self) -> tuple[str, ...]:
        """Every grasp that could not be tested, those of one file and reason together; rows count from 0."""
        groups: dict[tuple[str, str], list[int]] = {}
        for result in self.faults:
            place = self._place(result.row)
            key = place.get("file", ""), result.reason
            groups.setdefault(key, []).append(place.get("file_row", result.row))
        return tuple(
            f"{file}{' ' if file else ''}row{'s' if len(rows) > 1 else ''} {_ranges(rows)}: {reason}"
            for (file, reason), rows in groups.items()
        )

    def raise_for_faults(self) -> None:
        """To be called last: one sentence on the grasps that could not be tested.

        Raises:
            InputError: there are some; names all.
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
    """Numbers in words, neighbours together.

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


def result_to_json(result: HoldResult) -> dict[str, Any]:
    """A result as plain JSON values; numbers keep every digit."""
    return {**asdict(result), "status": result.status.name.lower()}


def result_from_json(document: dict[str, Any]) -> HoldResult:
    """The inverse of :func:`result_to_json`.

    Raises:
        KeyError, TypeError, ValueError: it is none.
    """
    names = {field.name for field in fields(HoldResult)}
    if set(document) != names:
        raise ValueError("other keys than a result has")
    shape = document["at_grasp"]
    return HoldResult(
        **{
            **document,
            "status": HoldStatus[document["status"].upper()],
            "probes": tuple(ProbeResult(**probe) for probe in document["probes"]),
            "at_grasp": None if shape is None else GraspGeometry(**shape),
        }
    )
