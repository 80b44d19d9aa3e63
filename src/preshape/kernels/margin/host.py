"""How well many candidate grasps resist wrenches: host side of the wrench-margin kernel.

Wrenches are (force, torque/ℓ) about a reference point, in units of the grip: the sum of the normal forces.
H is what contact forces inside the friction cones of soft fingers, √(|fₜ|²/μ² + m²/γ²) ≤ fₙ, can produce
with normal forces that sum to one; H₀ with normal forces that sum to at most one. For wrenches w asked for
on top of a base b

    residual = the largest distance of b + w from H, and
    strength = the largest k with b + k w/|w| in H₀ for every w,

with the cones as they are, not cut into facets. The kernel is :mod:`preshape.kernels.margin.warp`, on the
CPU and on CUDA; :mod:`preshape.kernels.margin.plain` is its specification. The measures of
:mod:`preshape.metrics` are exact, and a thousand times slower.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...exceptions import InputError
from ...types import Array, IntArray, frozen_array, read_only, value
from .cone import cone_starts

CONTACTS = 8
"""Most contacts of one candidate."""
WRENCHES = 32
"""Most wrenches asked for."""
HALF_ANGLE = math.radians(15.0)
_BASE, _BOUND, _FLOOR = 2, 15, 16
"""Places of base, bound and floor among the kernel's arguments."""


@value
class Margins:
    """How well c candidates resist.

    Attributes:
        residual: (c,) in units of the grip, right to 1 % and 5e-6; infinite without contacts; more than the
            bound, and no more exact than that, where the search ended at the bound.
        strength: (c,) in units of the grip, right to 1 % and 2e-5; 0 where the base is not in H₀, and where
            the search ended at the bound.
        residual_worst: (c,) index of the wrench that decided the residual; -1 where it is 0 or infinite.
        strength_worst: (c,) index of the wrench that decided the strength; -1 for none.
    """

    residual: Array
    strength: Array
    residual_worst: IntArray
    strength_worst: IntArray

    def __len__(self) -> int:
        return len(self.residual)


@value
class ConeStrengths:
    """How well c candidates resist every unit wrench of a cone.

    Attributes:
        strength: (c,) in units of the grip; 0 where the base is not in H₀.
        wrench: (c, 6) the unit wrench of the cone that decided.
    """

    strength: Array
    wrench: Array

    def __len__(self) -> int:
        return len(self.strength)


class MarginArrays(NamedTuple):
    """Results of c candidates on the device; see :class:`Margins`.

    Attributes:
        residual: (c,) float32.
        strength: (c,) float32.
        worst: (c, 2) int32, of the residual and of the strength.
        wrench: (c,) vectors of six: that decided the strength against a cone.
    """

    residual: Any
    strength: Any
    worst: Any
    wrench: Any


class MarginKernel:
    """What is asked of every candidate, on a device.

    Args:
        wrenches: (m, 6) asked for, 1 ≤ m ≤ 32; with a cone (1, 6), its axis.
        base: (6,) asked for all the while, such as minus the gravity; none if not given.
        friction: μ ≥ 0 of every contact.
        torsion: γ ≥ 0 of every contact [m]; 0 is a hard finger.
        half_angle: of a cone of wrenches [rad], 0..π/2. Then strength is against every unit wrench of the
            cone, and the residual is not computed (0).
        thorough: search a cone from twenty more of its wrenches, each by itself: nine times the work.
        device: ``cpu`` or a CUDA device's name.
        threads: parts of a batch that run side by side on the CPU; default one for each core.

    Raises:
        InputError: wrenches of the wrong shape or number, a cone's axis of zeros, negative coefficients, or
            no such device.
    """

    def __init__(
        self,
        wrenches: ArrayLike,
        *,
        base: ArrayLike | None = None,
        friction: float,
        torsion: float = 0.0,
        half_angle: float | None = None,
        thorough: bool = False,
        device: str = "cpu",
        threads: int | None = None,
    ) -> None:
        from ..launch import usable_threads, warp
        from ..packed_launch import FIRST, Launch, Rows

        asked = frozen_array(wrenches, (None, 6), "wrenches asked for")
        rest = frozen_array(np.zeros(6) if base is None else base, (6,), "the base wrench")
        if not 1 <= len(asked) <= WRENCHES:
            raise InputError(f"1 to {WRENCHES} wrenches can be asked for at once, got {len(asked)}")
        for name, number in (("friction", friction), ("torsional friction", torsion)):
            if not (math.isfinite(number) and number >= 0.0):
                raise InputError(f"{name} must be a number of at least 0, got {number:g}")
        axis, angle = np.zeros(6), 0.0
        if half_angle is not None:
            if len(asked) != 1 or not asked.any():
                raise InputError("a cone needs one wrench, not six zeros, as its axis")
            if not 0.0 <= half_angle <= math.pi / 2:
                raise InputError(f"a cone's half-angle must be in 0..π/2, got {half_angle:g}")
            axis, angle = asked[0] / np.linalg.norm(asked[0]), half_angle
            asked = cone_starts(axis, angle)
        anew = len(asked)
        if thorough:
            asked = np.concatenate([asked, asked, cone_starts(axis, angle, turned=True)])
        sizes = np.linalg.norm(asked, axis=1)
        units = asked / np.where(sizes > 0.0, sizes, 1.0)[:, None]

        self._wp = wp = warp()
        from . import warp as warp_margin
        from .warp_support import vec6

        try:
            wp.get_device(device)
        except (RuntimeError, ValueError) as error:
            known = ", ".join(str(d) for d in wp.get_devices())
            raise InputError(f"no device {device!r} here; known: {known}") from error
        wp.load_module(warp_margin, device=device)  # before any thread asks for it
        self._module, self._vec6, self.device = warp_margin, vec6, device
        self.threads = threads or usable_threads(device)
        self._asked = [
            wp.array(units.astype(np.float32), dtype=vec6, device=device),
            wp.array(sizes.astype(np.float32), dtype=wp.float32, device=device),
            vec6(*rest.tolist()),
            vec6(*axis.tolist()),
            math.cos(angle),
            math.sin(angle),
            anew,
            float(friction),
            float(torsion),
        ]

        def rows(dtype: Any, *shape: int) -> Rows:
            return Rows(dtype, *shape, device=device)

        contacts, each = [rows(wp.vec3, CONTACTS) for _ in range(2)], [rows(wp.float32) for _ in range(2)]
        self._in = *contacts, rows(wp.int32), *each
        self._out = MarginArrays(rows(wp.float32), rows(wp.float32), rows(wp.int32, 2), rows(vec6))
        self._compute = Launch(
            warp_margin.margins,
            [*self._asked, *self._in, wp.vec3(), math.inf, 0.0, FIRST, *self._out],
            device=device,
            threads=self.threads,
        )

    def room(self, count: int) -> MarginArrays:
        """Arrays on the device for the results of so many candidates."""
        wp = self._wp
        return MarginArrays(
            residual=wp.zeros(count, dtype=wp.float32, device=self.device),
            strength=wp.zeros(count, dtype=wp.float32, device=self.device),
            worst=wp.zeros((count, 2), dtype=wp.int32, device=self.device),
            wrench=wp.zeros(count, dtype=self._vec6, device=self.device),
        )

    def launch(
        self,
        points: Any,
        normals_in: Any,
        counts: Any,
        lengths: Any,
        out: MarginArrays,
        *,
        reference: tuple[float, float, float] = (0.0, 0.0, 0.0),
        bound: float = math.inf,
    ) -> None:
        """Compute on arrays that are on the device already; nothing is copied or checked.

        Args:
            points: (c, 8) ``vec3`` contact points [m].
            normals_in: (c, 8) ``vec3`` unit inward normals.
            counts: (c,) ``int32`` contacts.
            lengths: (c,) ``float32`` ℓ [m].
            out: where the results go; see :meth:`room`.
            reference: point about which torques are taken, in the frame of the points [m].
            bound: residual above which a candidate's search may end.
        """
        from ..launch import in_parts

        wp = self._wp
        about = wp.vec3(*reference)
        most = wp.full(len(counts), math.inf, dtype=float, device=self.device)
        given = [*self._asked, points, normals_in, counts, lengths, most, about, float(bound), 0.0]

        def part(first: int, size: int) -> None:
            wp.launch(
                self._module.margins,
                dim=size,
                inputs=[*given, first],
                outputs=list(out),
                device=self.device,
            )

        in_parts(part, len(counts), self.threads)

    def __call__(
        self,
        points: ArrayLike,
        normals_in: ArrayLike,
        counts: ArrayLike,
        length: ArrayLike,
        *,
        reference: ArrayLike = (0.0, 0.0, 0.0),
        bound: float = math.inf,
    ) -> MarginArrays:
        """Check host arrays, move them to the device and compute; see :func:`margins`.

        Returns:
            Host arrays.
        """
        p = frozen_array(points, (None, CONTACTS, 3), "contact points")
        n = frozen_array(normals_in, (len(p), CONTACTS, 3), "contact normals")
        c = frozen_array(counts, (len(p),), "numbers of contacts")
        ell = frozen_array(np.full(len(p), length) if np.ndim(length) == 0 else length, (len(p),), "lengths")
        about = frozen_array(reference, (3,), "the reference point")
        if len(p) and not (c.min() >= 0 and c.max() <= CONTACTS and (c == np.floor(c)).all()):
            raise InputError(
                f"counts of contacts must be whole and 0..{CONTACTS}, got {c.min():g}..{c.max():g}"
            )
        if len(p) and ell.min() <= 0.0:
            raise InputError(f"lengths must be positive, got {ell.min():g} m")
        if math.isnan(bound):
            raise InputError("the bound on the residual must be a number, got nan")
        with self._compute.lock:
            self._run((p, n, c, ell, about), bound)
            return MarginArrays(*(rows.get(len(p)) for rows in self._out))

    def strengths(
        self,
        points: Array,
        normals_in: Array,
        counts: IntArray,
        length: float,
        reference: Array,
        most: Array | float = math.inf,
        least: float = 0.0,
        base: Array | None = None,
    ) -> Array:
        """(c,) strength, unchecked: ``most`` where less; up to ``least``, only that; on ``base`` if given."""
        with self._compute.lock:
            self._run((points, normals_in, counts, length, reference), -1.0, most, least, base)
            return np.asarray(self._out.strength.get(len(points)), dtype=np.float64)

    def _run(
        self,
        given: tuple[Array, Array, Any, Array | float, Array],
        bound: float,
        most: Array | float = math.inf,
        least: float = 0.0,
        base: Array | None = None,
    ) -> None:
        points, normals, counts, lengths, about = given
        each = [np.broadcast_to(one, len(points)) for one in (lengths, most)]
        for rows, values in zip(self._in, (points - about, normals, counts, *each), strict=True):
            rows.put(values)
        rest = self._asked[_BASE] if base is None else self._vec6(*base.tolist())
        self._compute(len(points), {_BASE: rest, _BOUND: float(bound), _FLOOR: float(least)})


def margins(
    points: ArrayLike,
    normals_in: ArrayLike,
    counts: ArrayLike,
    *,
    wrenches: ArrayLike,
    base: ArrayLike | None = None,
    friction: float,
    torsion: float = 0.0,
    length: ArrayLike,
    reference: ArrayLike = (0.0, 0.0, 0.0),
    bound: float = math.inf,
    threads: int | None = None,
    device: str = "cpu",
) -> Margins:
    """Residual and strength of many candidates.

    Args:
        points: (c, 8, 3) contact points [m]; only the first ``counts`` matter.
        normals_in: (c, 8, 3) unit inward normals.
        counts: (c,) contacts, 0..8.
        wrenches: (m, 6) asked for (force; torque over ℓ) in units of the grip, 1 ≤ m ≤ 32.
        base: (6,) asked for all the while, such as minus the gravity, in units of the grip.
        friction: μ.
        torsion: γ [m].
        length: ℓ > 0 [m], one or (c,).
        reference: (3,) point about which torques are taken [m].
        bound: the search of a candidate ends where its residual is certainly above this.
        threads: parts of the batch that run side by side on the CPU; the results do not depend on it.
        device: ``cpu`` or a CUDA device's name.

    Raises:
        InputError: wrong shapes, numbers that are not finite, or out of range.
    """
    kernel = MarginKernel(
        wrenches, base=base, friction=friction, torsion=torsion, device=device, threads=threads
    )
    out = kernel(points, normals_in, counts, length, reference=reference, bound=bound)
    worst = out.worst.astype(np.int64)
    return Margins(
        residual=read_only(out.residual.astype(np.float64)),
        strength=read_only(out.strength.astype(np.float64)),
        residual_worst=read_only(worst[:, 0]),
        strength_worst=read_only(worst[:, 1]),
    )


def cone_strengths(
    points: ArrayLike,
    normals_in: ArrayLike,
    counts: ArrayLike,
    *,
    direction: ArrayLike,
    half_angle: float = HALF_ANGLE,
    thorough: bool = False,
    base: ArrayLike | None = None,
    friction: float,
    torsion: float = 0.0,
    length: ArrayLike,
    reference: ArrayLike = (0.0, 0.0, 0.0),
    threads: int | None = None,
    device: str = "cpu",
) -> ConeStrengths:
    """Strength of many candidates against every unit wrench within ``half_angle`` of a direction.

    The same as :func:`preshape.metrics.task_margin` with ``ForceLimits(total=1)``, by a search from fewer
    wrenches of the cone: a missed minimum makes the strength too large, never too small. Of the grips that
    searches for real hands come to, 92 % were right to 1 % and the worst was 18 % too large; by the thorough
    search 99.8 %, and 2.5 %.

    Args:
        points: as in :func:`margins`; so are the others that are not named here.
        normals_in: (c, 8, 3).
        counts: (c,).
        direction: (6,) the task's wrench; only its direction counts.
        half_angle: of the cone [rad], 0..π/2.
        thorough: search from three times as many wrenches, which takes nine times as long.
        base: (6,).
        friction: μ.
        torsion: γ [m].
        length: ℓ [m].
        reference: (3,) [m].
        threads: on the CPU.
        device: ``cpu`` or a CUDA device's name.

    Raises:
        InputError: wrong shapes, numbers that are not finite, or out of range.
    """
    axis = frozen_array(direction, (6,), "task direction")
    kernel = MarginKernel(
        axis[None],
        base=base,
        friction=friction,
        torsion=torsion,
        half_angle=half_angle,
        thorough=thorough,
        device=device,
        threads=threads,
    )
    out = kernel(points, normals_in, counts, length, reference=reference)
    return ConeStrengths(
        strength=read_only(out.strength.astype(np.float64)),
        wrench=read_only(out.wrench.astype(np.float64)),
    )
