"""How well candidate grasps resist wrenches: the host side of the wrench-margin kernel.

Wrenches are (force, torque/ℓ) about a reference point, in units of the grip, which is the sum of the normal
forces. The contact forces lie in the friction cones of soft fingers, √(|fₜ|²/μ² + m²/γ²) ≤ fₙ. H is the set
of wrenches that they can produce if the normal forces sum to one; H₀ is the same set if they sum to at most
one. Each wrench w is demanded in addition to a constant base b:

    residual = the largest distance of b + w from H, over all w, and
    strength = the largest k with b + k w/|w| in H₀ for every w.

If each contact has a largest normal force of its own, both sets are the wrenches that the contacts can
produce within these bounds, and wrenches, base and results are in newtons. Of 1,500 random candidates of 3 to
24 contacts on a base, those whose strength was above a thousandth of the sum of their bounds were accurate to
1 %, but for one (5.5 % too large); below that, the error may reach a ten-thousandth of the sum.

The friction cones are exact, not polyhedral. The kernel is :mod:`.warp`, on the CPU and on CUDA;
:mod:`.plain` is its specification. The measures of :mod:`preshape.metrics` are exact, but a thousand times
slower.
"""

from __future__ import annotations

import math
from functools import cached_property
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...exceptions import InputError, shown
from ...types import Array, IntArray, frozen_array, read_only, value
from ..packed_launch import FIRST_ROW, DeviceRows, PackedLaunch

CONTACTS = MOST_CONTACTS = 24
"""Largest number of contacts of one candidate."""
FEW_CONTACTS = 8
"""Number of contacts up to which the margins without bounds are computed by a faster form of the kernel."""
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


class MarginLaunch(NamedTuple):
    """One form of the kernel with its arrays.

    Attributes:
        inputs: Input rows by name.
        outputs: Output rows by name.
        compute: The launch.
    """

    inputs: dict[str, DeviceRows]
    outputs: dict[str, DeviceRows]
    compute: PackedLaunch


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
        from ..launch import usable_threads, warp

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
        self.device, self._threads = device, threads or usable_threads(device)
        self._vec6, self._base = vec6, vec6(*always.tolist())
        self._model = {
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
        self._few = self._launch(warp_margin, warp_margin.margins, FEW_CONTACTS)

    @cached_property
    def _many(self) -> MarginLaunch:
        """The form for many contacts and for bounds, compiled and loaded when it is first needed."""
        from . import warp_many

        return self._launch(warp_many, warp_many.many_margins, CONTACTS, many=True)

    def _launch(self, module: ModuleType, kernel: Any, contacts: int, *, many: bool = False) -> MarginLaunch:
        from ..cache import load_kernels
        from ..launch import warp

        wp = warp()
        load_kernels(module, self.device)

        def rows(dtype: Any, *shape: int) -> DeviceRows:
            return DeviceRows(dtype, *shape, device=self.device)

        inputs = {
            "arms" if many else "points": rows(wp.vec3, contacts),
            "normals_in": rows(wp.vec3, contacts),
            "counts": rows(wp.int32),
            "lengths": rows(wp.float32),
            "most": rows(wp.float32),
        }
        settings: dict[str, Any] = {}
        if many:
            inputs |= {"shares": rows(wp.float32, contacts), "totals": rows(wp.float32)}
            settings = {"bounded": False}
        settings |= {"bound": math.inf, "floor": 0.0, "first": FIRST_ROW}
        outputs = {
            "residual": rows(wp.float32),
            "strength": rows(wp.float32),
            "worst": rows(wp.int32, 2),
            "wrench": rows(self._vec6),
        }
        arguments = {**self._model, **inputs, **settings, **outputs}
        compute = PackedLaunch(kernel, arguments, device=self.device, threads=self._threads)
        return MarginLaunch(inputs, outputs, compute)

    def __call__(
        self,
        points: ArrayLike,
        normals_in: ArrayLike,
        counts: ArrayLike,
        length: ArrayLike,
        *,
        bounds: ArrayLike | None = None,
        reference: ArrayLike = (0.0, 0.0, 0.0),
        bound: float = math.inf,
    ) -> dict[str, Any]:
        """Check the arguments and compute; see :func:`margins` and, for ``bounds``, :meth:`strengths`.

        Returns:
            The arrays ``residual`` (c,); ``strength`` (c,); ``worst`` (c, 2), the indices of the wrenches
            that decided them; and ``wrench`` (c, 6), the wrench that decided the strength against a cone.
        """
        p = frozen_array(points, (None, None, 3), "contact points")
        most = p.shape[1]
        n = frozen_array(normals_in, (len(p), most, 3), "contact normals")
        c = frozen_array(counts, (len(p),), "numbers of contacts")
        ell = frozen_array(np.full(len(p), length) if np.ndim(length) == 0 else length, (len(p),), "lengths")
        if most > CONTACTS:
            raise InputError(f"a candidate may have up to {CONTACTS} contacts, got {most}")
        if bounds is not None:
            bounds = frozen_array(bounds, (len(p), most), "largest normal forces")
            if bounds.size and bounds.min() < 0.0:
                raise InputError(f"largest normal forces must be at least 0 N, got {bounds.min():g} N")
        about = frozen_array(reference, (3,), "the reference point")
        if len(p) and not (c.min() >= 0 and c.max() <= most and (c == np.floor(c)).all()):
            raise InputError(f"counts of contacts must be whole and 0..{most}, got {c.min():g}..{c.max():g}")
        if len(p) and ell.min() <= 0.0:
            raise InputError(f"lengths must be positive, got {ell.min():g} m")
        if math.isnan(bound):
            raise InputError("the bound on the residual must be a number, got nan")
        launch, given, settings = self._given(p - about, n, c, ell, math.inf, bounds)
        with launch.compute.lock:
            self._run(launch, given, {**settings, "bound": float(bound), "floor": 0.0}, None)
            return {name: rows.get(len(p)) for name, rows in launch.outputs.items()}

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
        bounds: Array | None = None,
    ) -> Array:
        """(c,) strengths in units of the grip, or in newtons with ``bounds``; the arguments are not checked.

        Args:
            points: (c, k, 3) contact points [m]; this and the next four arguments are as in :func:`margins`.
            normals_in: (c, k, 3) unit inward normals.
            counts: (c,) numbers of contacts.
            length: ℓ [m].
            reference: (3,) point about which torques are taken [m].
            most: Strengths above this value are returned as this value; one number or (c,).
            least: The search of a candidate ends as soon as its strength is known not to exceed this.
            base: (6,) base that replaces that of the kernel.
            bounds: (c, k) largest normal force of each contact [N]; ``base``, ``most`` and ``least`` are then
                in newtons. A strength up to 4e-6 of the sum of a candidate's bounds counts as 0. ``None`` for
                normal forces that sum to at most one.
        """
        launch, given, settings = self._given(points - reference, normals_in, counts, length, most, bounds)
        with launch.compute.lock:
            self._run(launch, given, {**settings, "bound": -1.0, "floor": float(least)}, base)
            return np.asarray(launch.outputs["strength"].get(len(points)), dtype=np.float64)

    def _given(
        self,
        points: Array,
        normals_in: Array,
        counts: Array | IntArray,
        length: Array | float,
        most: Array | float,
        bounds: Array | None,
    ) -> tuple[MarginLaunch, tuple[Any, ...], dict[str, bool]]:
        """The launch to use, its input rows, and its setting."""
        width = points.shape[1]
        if bounds is None and (width <= FEW_CONTACTS or np.max(counts, initial=0) <= FEW_CONTACTS):
            cut = min(width, FEW_CONTACTS)
            wide = _padded(points[:, :cut], FEW_CONTACTS), _padded(normals_in[:, :cut], FEW_CONTACTS)
            return self._few, (*wide, counts, length, most), {}
        # Points and bounds beyond the counts are of no contact. The arms are divided in single precision, as
        # in the other form, so that the results of few contacts do not depend on the form.
        used = np.arange(width) < np.reshape(counts, (-1, 1))
        arms = np.float32(points) / np.reshape(np.float32(length), (-1, 1, 1))
        arms = np.where(used[:, :, None], arms, np.float32(0.0))
        normals = np.where(used[:, :, None], normals_in, 0.0)
        totals, shares = np.ones(len(points)), np.zeros(used.shape)
        if bounds is not None:
            shares = np.where(used, bounds, 0.0)
            totals = shares.sum(axis=1)
        # A candidate without force, or with numbers that are none, is one without contacts.
        good = np.isfinite(totals + arms.sum(axis=(1, 2)) + normals.sum(axis=(1, 2))) & (totals > 0.0)
        totals[~good] = 1.0
        padded = [_padded(np.asarray(x), CONTACTS) for x in (arms, normals, shares / totals[:, None])]
        given = (padded[0], padded[1], np.where(good, counts, 0), length, most, padded[2], totals)
        return self._many, given, {"bounded": bounds is not None}

    def _run(
        self, launch: MarginLaunch, given: tuple[Any, ...], settings: dict[str, Any], base: Array | None
    ) -> None:
        count = len(given[0])
        for rows, values in zip(launch.inputs.values(), given, strict=True):
            rows.put(values if np.ndim(values) else np.broadcast_to(values, count))
        always = self._base if base is None else self._vec6(*base.tolist())
        launch.compute(count, {**settings, "base": always})


def _padded(values: Array, width: int) -> Array:
    """(n, width, ...) values with zeros added to (n, k, ...)."""
    if values.shape[1] == width:
        return values
    wide = np.zeros((len(values), width, *values.shape[2:]), dtype=values.dtype)
    wide[:, : values.shape[1]] = values  # numpy.pad takes ten times as long
    return wide


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
        points: (c, k, 3) contact points [m], k ≤ 24; only the first ``counts`` are used.
        normals_in: (c, k, 3) unit inward normals.
        counts: (c,) numbers of contacts, 0..k.
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
