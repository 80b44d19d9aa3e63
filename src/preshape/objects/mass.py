"""The mass used in planning: given by the caller, known of the object, or estimated from its volume.

A mass given by the caller takes precedence over the mass of the mesh (library objects have one). Without
either, the mass is the larger of 0.1 kg and the volume times the density of water, and the answer states this
assumption.
"""

from __future__ import annotations

from ..types import positive_number, value
from . import checks
from .mesh import TriangleMesh

LEAST_ESTIMATE = 0.1
"""Least estimated mass [kg]."""
WATER = 1000.0
"""Assumed density of an object of unknown mass [kg/m³]."""
DENSEST, LIGHTEST = 25_000.0, 5.0
"""Densities outside this range probably come from a wrong unit [kg/m³]; osmium has 22 600, foam rubber 20."""
HEAVIEST_ESTIMATE = 100.0
"""An estimate above this probably comes from a wrong unit [kg]; no hand lifts as much [C]."""
MASS_UNITS = {"g": 1e-3, "lb": 0.45359237}
"""Units in which a mass may have been given by mistake [kg]."""
SOLID = 20.0, 12_000.0
"""Densities of plausible objects, from foam to lead [kg/m³]."""
SHEET = 1e-3
"""A mesh with less volume than this share of its bounding box is an open sheet, whose density is unknown."""


@value
class ObjectMass:
    """The mass of one object, and where it comes from.

    Attributes:
        kg: The mass [kg].
        source: ``given`` by the caller, ``known`` of the object, or ``volume`` (an estimate).
        warning: What to check if density or estimate is absurd, or if the estimate counts the inside of an
            open surface; otherwise empty.
    """

    kg: float
    source: str
    warning: str = ""

    @property
    def words(self) -> str:
        """The mass and where it comes from, for display.

        >>> ObjectMass(kg=0.3, source="known").words
        "0.3 kg (the object's own mass)"
        """
        return f"{self.kg:.3g} kg ({_SOURCES[self.source]})"


_SOURCES = {
    "given": "as given",
    "known": "the object's own mass",
    "volume": "assumed: the volume filled with water, at least 0.1 kg; --mass sets it",
}


_CHECKS = {
    "given": "check --mass, which is in kilograms, and the --unit of the file",
    "known": "check the mass of the object, which is in kilograms, and its size",
    "volume": "check --unit and --scale of the file, and state --mass",
}


def object_mass(mesh: TriangleMesh, given: float | None = None) -> ObjectMass:
    """The mass used in planning with a mesh.

    Args:
        mesh: The object [m].
        given: The mass that the caller states [kg]; ``None`` to use the object's own or an estimate.

    Raises:
        InputError: The given mass is not a positive, finite number.
    """
    if given is not None:
        kg, source = positive_number(given, "mass", "a positive number of kilograms"), "given"
    elif mesh.mass is not None:
        kg, source = mesh.mass, "known"
    else:
        kg, source = max(LEAST_ESTIMATE, WATER * abs(mesh.volume)), "volume"
    warnings = [_mass_warning(mesh, kg, source)]
    if source == "volume" and mesh.lids:
        warnings.append(
            f"the assumed mass of {kg:.3g} kg counts all that the lids enclose as filled with water: the "
            "file's surface is open; state the mass of the real object with --mass"
        )
    return ObjectMass(kg=kg, source=source, warning="; ".join(filter(None, warnings)))


def _mass_warning(mesh: TriangleMesh, kg: float, source: str) -> str:
    """What is absurd about a mass, and which unit would make it plausible; empty if nothing is absurd."""
    box, volume = float(mesh.extents.prod()), abs(mesh.volume)
    if source == "volume" and kg > HEAVIEST_ESTIMATE:
        return (
            f"the object's volume of {volume:.3g} m³ filled with water weighs {kg:.3g} kg: "
            f"{_remedy(mesh, kg, volume, source)}"
        )
    # The volume of a sheet is not that of its body, which is at most that of the bounding box.
    sheet = volume < SHEET * box
    volume = box if sheet else volume
    density = kg / volume if volume > 0 else 0.0
    if (sheet and density <= DENSEST) or LIGHTEST <= density <= DENSEST:
        return ""
    side = "denser than any metal" if density > DENSEST else "lighter than any foam"
    subject = "the assumed mass" if source == "volume" else "a mass"
    return (
        f"{subject} of {kg:.3g} kg in {1e6 * volume:.3g} cm³ is {density:.2g} kg/m³, {side}: "
        f"{_remedy(mesh, kg, volume, source)}"
    )


def _remedy(mesh: TriangleMesh, kg: float, volume: float, source: str) -> str:
    """What to check, with the unit of the mass or of the file that would make the density plausible."""
    if source == "given" and volume > 0:
        for unit, factor in MASS_UNITS.items():
            if SOLID[0] <= factor * kg / volume <= SOLID[1]:
                return f"--mass is in kilograms; {kg:.3g} {unit} are --mass {factor * kg:.3g}"
    largest = float(mesh.extents.max())
    absurd = not checks.GRASPABLE[0] <= largest <= checks.GRASPABLE[1]
    units = checks.other_units(mesh.extents, mesh.unit) if absurd and source != "known" else ""
    return units or _CHECKS[source]
