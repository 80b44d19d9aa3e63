"""The mass used in planning: given by the caller, known of the object, or estimated from its volume.

A mass given by the caller takes precedence over the mass of the mesh (library objects have one). Without
either, the mass is the larger of 0.1 kg and the volume times the density of water, and the answer states this
assumption.
"""

from __future__ import annotations

import math

from ..exceptions import InputError
from ..types import value
from .mesh import TriangleMesh

LEAST_ESTIMATE = 0.1
"""Least estimated mass [kg]."""
WATER = 1000.0
"""Assumed density of an object of unknown mass [kg/m³]."""
DENSEST, LIGHTEST = 25_000.0, 5.0
"""Densities outside this range probably come from a wrong unit [kg/m³]; osmium has 22 600, foam rubber 20."""
SHEET = 1e-3
"""A mesh with less volume than this share of its bounding box is an open sheet, whose density is unknown."""


@value
class ObjectMass:
    """The mass of one object, and where it comes from.

    Attributes:
        kg: The mass [kg].
        source: ``given`` by the caller, ``known`` of the object, or ``volume`` (an estimate).
        warning: One sentence when the density is absurd, else empty.
    """

    kg: float
    source: str
    warning: str = ""

    @property
    def words(self) -> str:
        """The mass and where it comes from, for display.

        >>> ObjectMass(kg=0.3, source="known").words
        '0.3 kg (the mass of the built-in object)'
        """
        return f"{self.kg:.3g} kg ({_SOURCES[self.source]})"


_SOURCES = {
    "given": "as given",
    "known": "the mass of the built-in object",
    "volume": "assumed: the volume filled with water, at least 0.1 kg; --mass sets it",
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
        if isinstance(given, bool) or not isinstance(given, int | float) or not 0 < given < math.inf:
            raise InputError(f"mass must be a positive number of kilograms, got {given!r}")
        return ObjectMass(kg=float(given), source="given", warning=_density_warning(mesh, given))
    if mesh.mass is not None:
        return ObjectMass(kg=mesh.mass, source="known")
    estimate = max(LEAST_ESTIMATE, WATER * abs(mesh.volume))
    return ObjectMass(kg=estimate, source="volume")


def _density_warning(mesh: TriangleMesh, kg: float) -> str:
    volume = abs(mesh.volume)
    if volume < SHEET * float(mesh.extents.prod()) or volume <= 0:
        return ""
    density = kg / volume
    if LIGHTEST <= density <= DENSEST:
        return ""
    side = "denser than any metal" if density > DENSEST else "lighter than any foam"
    return (
        f"a mass of {kg:.3g} kg in {1e6 * volume:.3g} cm³ is {density:.2g} kg/m³, {side}: "
        "check --mass, which is in kilograms, and the --unit of the file"
    )
