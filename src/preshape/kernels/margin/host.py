"""How well candidate grasps resist wrenches: the host side of the wrench-margin kernel.

Wrenches are (force, torque/ℓ) about a reference point, in units of the grip, which is the sum of the normal
forces. The contact forces lie in the friction cones of soft fingers, √(|fₜ|²/μ² + m²/γ²) ≤ fₙ. H is the set
of wrenches that they can produce if the normal forces sum to one; H₀ is the same set if they sum to at most
one. Each wrench w is demanded in addition to a constant base b:

    residual = the largest distance of b + w from H, over all w, and
    strength = the largest k with b + k w/|w| in H₀ for every w.

The friction cones are exact, not polyhedral. The kernel is :mod:`.warp`, on the CPU and on CUDA;
:mod:`.plain` is its specification. The measures of :mod:`preshape.metrics` are exact, but a thousand times
slower.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...exceptions import InputError, shown
from ...types import Array, IntArray, frozen_array, read_only, value

CONTACTS = MOST_CONTACTS = 24
"""Largest number of contacts of one candidate."""
WRENCHES = 32
"""Largest number of demanded wrenches."""
_ROTATED = np.eye(5) - 0.4
"""Five mutually perpendicular directions, each at 53° or more to every axis."""


@value
class Margins:
    """How well c candidates resist the demanded wrenches.

    Attributes:
        residual: (c,) in units of the grip, accurate to 1 % and 5e-6; infinite without contacts. If the
            search ended at the bound, it is only known that the residual is above the bound.
        strength: (c,) in units of the grip, accurate to 1 % and 2e-5; 0 if the base is not in H₀ or the
            search ended at the bound.
        residual_worst: (c,) index of the wrench that decided the residual; -1 if it is 0 or infinite.
        strength_worst: (c,) index of the wrench that decided the strength; -1 if no wrench did.
    """

    residual: Array
    strength: Array
    residual_worst: IntArray
    strength_worst: IntArray

    def __len__(self) -> int:
        return len(self.residual)


def cone_starts(axis: Array, half_angle: float, *, rotated: bool = False) -> Array:
    """(11, 6) unit wrenches of a cone from which the search starts: the axis, and ten of the rim.

    Args:
        axis: (6,) unit axis of the cone.
        half_angle: Half-angle of the cone [rad].
        rotated: Whether to take ten other wrenches of the rim instead, as far from the first ten as possible;
            the axis is then left out.
    """
    if half_angle == 0.0:
        return axis[None]
    # Five directions perpendicular to the axis and to each other: columns of the reflection that maps e₀ to
    # it.
    normal = axis - np.eye(6)[0] * (1.0 if axis[0] <= 0.0 else -1.0)
    across = (np.eye(6) - 2.0 * np.outer(normal, normal) / (normal @ normal))[1:]
    if rotated:
        across = _ROTATED @ across
    rim = math.cos(half_angle) * axis + math.sin(half_angle) * np.concatenate([across, -across])
    return rim if rotated else np.concatenate([axis[None], rim])


class MarginKernel:
    """The wrenches that are demanded of every candidate, on a device.

    Args:
        wrenches: (m, 6) demanded wrenches, 1 ≤ m ≤ 32; with a cone (1, 6), the axis of the cone.
        base: (6,) wrench that is demanded all the time, such as minus the weight; default zero.
        friction: μ ≥ 0 of every contact.
        torsion: γ ≥ 0 of every contact [m]; 0 is a hard finger.
        half_angle: Half-angle of a cone of wrenches [rad], 0..π/2. With a cone, every unit wrench of the cone
            is demanded, as in :func:`preshape.metrics.task_margin` with ``ForceLimits(total=1)``, and the
            residual is 0 (not computed). If the search misses a minimum, the strength is too large, never too
            small. Of the grasps found for real hands, 92 % were accurate to 1 %; the worst was 18 % too
            large.
        thorough: Search a cone from twenty more of its wrenches, each independently. This takes nine times as
            long; 99.8 % were accurate to 1 %, and the worst was 2.5 % too large.
        device: ``cpu`` or a CUDA device's name.
        threads: Number of CPU threads; default one for each core.

    Raises:
        InputError: The wrenches have the wrong shape or number, a cone's axis is zero, a coefficient is
            negative, or there is no such device.
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
        from ..cache import load_kernels
        from ..launch import usable_threads, warp
        from ..packed_launch import FIRST_ROW, DeviceRows, PackedLaunch

        asked = frozen_array(wrenches, (None, 6), "wrenches asked for")
        always = frozen_array(np.zeros(6) if base is None else base, (6,), "the base wrench")
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
        restart = len(asked)
        if thorough:
            asked = np.concatenate([asked, asked, cone_starts(axis, angle, rotated=True)])
        sizes = np.linalg.norm(asked, axis=1)
        units = asked / np.where(sizes > 0.0, sizes, 1.0)[:, None]

        wp = warp()
        from . import warp as warp_margin
        from .warp_support import vec6

        try:
            wp.get_device(device)
        except (RuntimeError, ValueError) as error:
            known = ", ".join(str(d) for d in wp.get_devices())
            raise InputError(f"no device {shown(device)} here; known: {known}") from error
        load_kernels(warp_margin, device)

        def rows(dtype: Any, *shape: int) -> DeviceRows:
            return DeviceRows(dtype, *shape, device=device)

        self._vec6, self._base = vec6, vec6(*always.tolist())
        model = {
            "units": wp.array(units.astype(np.float32), dtype=vec6, device=device),
            "sizes": wp.array(sizes.astype(np.float32), dtype=wp.float32, device=device),
            "base": self._base,
            "axis": vec6(*axis.tolist()),
            "cos_half": math.cos(angle),
            "sin_half": math.sin(angle),
            "restart": restart,
            "friction": float(friction),
            "torsion": float(torsion),
        }
        self._in = {
            "points": rows(wp.vec3, CONTACTS),
            "normals_in": rows(wp.vec3, CONTACTS),
            "counts": rows(wp.int32),
            "lengths": rows(wp.float32),
            "most": rows(wp.float32),
        }
        settings = {"bound": math.inf, "floor": 0.0, "first": FIRST_ROW}
        self._out = {
            "residual": rows(wp.float32),
            "strength": rows(wp.float32),
            "worst": rows(wp.int32, 2),
            "wrench": rows(vec6),
        }
        self._compute = PackedLaunch(
            warp_margin.margins,
            {**model, **self._in, **settings, **self._out},
            device=device,
            threads=threads or usable_threads(device),
        )

    def __call__(
        self,
        points: ArrayLike,
        normals_in: ArrayLike,
        counts: ArrayLike,
        length: ArrayLike,
        *,
        reference: ArrayLike = (0.0, 0.0, 0.0),
        bound: float = math.inf,
    ) -> dict[str, Any]:
        """Check the arguments and compute; see :func:`margins`.

        Returns:
            The arrays ``residual`` (c,); ``strength`` (c,); ``worst`` (c, 2), the indices of the wrenches
            that decided them; and ``wrench`` (c, 6), the wrench that decided the strength against a cone.
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
            self._run((p - about, n, c, ell, math.inf), bound, 0.0, None)
            return {name: rows.get(len(p)) for name, rows in self._out.items()}

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
        """(c,) strengths in units of the grip; the arguments are not checked.

        Args:
            points: (c, 8..24, 3) contact points [m]; this and the next four arguments are as in :func:`margins`.
            normals_in: (c, 8..24, 3) unit inward normals.
            counts: (c,) numbers of contacts.
            length: ℓ [m].
            reference: (3,) point about which torques are taken [m].
            most: Strengths above this value are returned as this value; one number or (c,).
            least: The search of a candidate ends as soon as its strength is known not to exceed this.
            base: (6,) base that replaces that of the kernel.
        """
        with self._compute.lock:
            self._run((points - reference, normals_in, counts, length, most), -1.0, least, base)
            return np.asarray(self._out["strength"].get(len(points)), dtype=np.float64)

    def _run(self, given: tuple[Any, ...], bound: float, floor: float, base: Array | None) -> None:
        count, (points, normals, *rest) = len(given[0]), given
        if points.shape[1] < CONTACTS:  # fingertip grips have fewer than wraps
            wider = [(0, 0), (0, CONTACTS - points.shape[1]), (0, 0)]
            points, normals = np.pad(points, wider), np.pad(normals, wider)
        for rows, values in zip(self._in.values(), (points, normals, *rest), strict=True):
            rows.put(values if np.ndim(values) else np.broadcast_to(values, count))
        always = self._base if base is None else self._vec6(*base.tolist())
        self._compute(count, {"base": always, "bound": float(bound), "floor": float(floor)})


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
        points: (c, 8..24, 3) contact points [m]; only the first ``counts`` are used.
        normals_in: (c, 8..24, 3) unit inward normals.
        counts: (c,) numbers of contacts, 0..8.
        wrenches: (m, 6) demanded wrenches (force; torque/ℓ) in units of the grip, 1 ≤ m ≤ 32.
        base: (6,) wrench that is demanded all the time, such as minus the weight, in units of the grip.
        friction: μ.
        torsion: γ [m].
        length: ℓ > 0 [m], one number or (c,).
        reference: (3,) point about which torques are taken, in the frame of the points [m].
        bound: The search of a candidate ends as soon as its residual is known to exceed this.
        threads: Number of CPU threads; the results do not depend on it.
        device: ``cpu`` or a CUDA device's name.

    Raises:
        InputError: An array has the wrong shape, or a number is not finite or out of range.
    """
    kernel = MarginKernel(
        wrenches, base=base, friction=friction, torsion=torsion, device=device, threads=threads
    )
    out = kernel(points, normals_in, counts, length, reference=reference, bound=bound)
    worst = out["worst"].astype(np.int64)
    return Margins(
        residual=read_only(out["residual"].astype(np.float64)),
        strength=read_only(out["strength"].astype(np.float64)),
        residual_worst=read_only(worst[:, 0]),
        strength_worst=read_only(worst[:, 1]),
    )
