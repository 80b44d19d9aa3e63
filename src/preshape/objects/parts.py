"""Parts of an object: named regions of its surface, and volumes beside it that are to stay free."""

from __future__ import annotations

from ..exceptions import InputError, shown
from ..types import Array, IntArray, freeze, frozen_array, value


@value
class PartSurface:
    """The surface of a part, or of a volume beside the object that is to stay free.

    Attributes:
        name: Name of the part in sentences, as ``handle``.
        vertices: (n, 3) positions in the mesh frame [m].
        triangles: (m, 3) vertex indices; for a solid, outward (right-hand rule).
        solid: Whether the triangles bound a closed volume, whose inside belongs to the part too.

    Raises:
        InputError: The name is empty, an array has the wrong shape, or an index is out of range.
    """

    name: str
    vertices: Array
    triangles: IntArray
    solid: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise InputError(f"a part needs a name, got {shown(self.name)}")
        vertices = frozen_array(self.vertices, (None, 3), f"the part {self.name}: vertices")
        corners = frozen_array(self.triangles, (None, 3), f"the part {self.name}: triangles")
        triangles = corners.astype("int64")
        if len(triangles) and not 0 <= triangles.min() <= triangles.max() < len(vertices):
            raise InputError(f"the part {self.name}: an index is outside of the {len(vertices)} vertices")
        triangles.flags.writeable = False
        freeze(self, vertices=vertices, triangles=triangles, solid=bool(self.solid))

    def __len__(self) -> int:
        return len(self.triangles)
