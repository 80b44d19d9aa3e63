"""Parts of the built-in objects, from the dimensions of their generators, and which parts each task holds.

Regions are in **millimetres** in the frame of the generator (:mod:`preshape.objects.generator`), in which the
object's axis or middle is the origin; :mod:`preshape.objects.library` moves them into the mesh frame. Borders
lie where two features of the generator meet, or in the middle of a wall.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise

import numpy as np

from .generator.shapes import curve
from .parts import LIBRARY, ObjectPart, PartRule
from .regions import SIDES, AllOf, AnyOf, Facing, HalfSpace, Outside, SurfaceRegion, beyond, box, cylinder

Parts = dict[str, SurfaceRegion]

UP = Facing(direction=np.array([0.0, 0.0, 1.0]), least=0.7)
DOWN = Facing(direction=np.array([0.0, 0.0, -1.0]), least=0.7)


def _over(axis: str, limit: float) -> SurfaceRegion:
    return beyond(axis, ">", limit)


def _under(axis: str, limit: float) -> SurfaceRegion:
    return beyond(axis, "<", limit)


def _between(axis: str, low: float, high: float) -> SurfaceRegion:
    return _over(axis, low) & _under(axis, high)


def _bar(radius: float, low: float = -500.0, high: float = 500.0) -> SurfaceRegion:
    """A round bar about the z axis [mm]."""
    return cylinder([0, 0, low], [0, 0, high], radius)


def _turned(profile: Sequence[Sequence[float]]) -> SurfaceRegion:
    """The inside of a surface of revolution about z, whose (radius, height) rise with height [mm]."""
    layers: list[SurfaceRegion] = []
    for (r0, z0), (r1, z1) in pairwise(profile):
        sides: list[SurfaceRegion] = [_between("z", z0, z1)]
        for angle in 2 * np.pi * np.arange(SIDES) / SIDES:
            # Points (r, z) with (z1 - z0) (r - r0) < (r1 - r0) (z - z0), along one direction.
            across = -(z1 - z0) * np.array([np.cos(angle), np.sin(angle)])
            normal = np.array([*across, r1 - r0])
            sides.append(HalfSpace(normal=normal, offset=(r1 - r0) * z0 - (z1 - z0) * r0))
        layers.append(AllOf(regions=tuple(sides)))
    return AnyOf(regions=tuple(layers))


def _middle_of_wall(outside: Sequence[tuple[float, float]], wall: float, per_span: int) -> list[list[float]]:
    """(radius, height) in the middle of a wall whose outside is a curve from the foot to the rim [mm]."""
    line = curve(outside, per_span)
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    middle = line + wall / 2 * np.column_stack([-along[:, 1], along[:, 0]])
    return [[float(r), float(z)] for r, z in middle]


def _rest(parts: Parts, *others: str) -> SurfaceRegion:
    """What none of the named parts has; of all parts without a name."""
    return Outside(region=AnyOf(regions=tuple(parts[name] for name in others or tuple(parts))))


def _faces() -> Parts:
    return {"top": UP, "bottom": DOWN, "sides": Outside(region=UP | DOWN)}


def _pyramid() -> Parts:
    return {"tip": _over("z", 42), "base": DOWN, "sides": Outside(region=DOWN)}


def _cone() -> Parts:
    return {"tip": _over("z", 60), "base": DOWN, "side": Outside(region=DOWN)}


def _sphere() -> Parts:
    return {"upper half": _over("z", 0), "lower half": _under("z", 0)}


def _ring() -> Parts:
    return {"inside": _bar(34), "outside": Outside(region=_bar(34))}


def _wedge() -> Parts:
    parts = {"edge": _under("x", 15), "back": _over("x", 88)}
    return parts | {"bottom": DOWN, "top": Facing(direction=np.array([0.0, 0.0, 1.0]), least=0.5)}


def _brick() -> Parts:
    parts = {"studs": _over("z", 19.3), "underside": box([-29.2, -13.2, -1], [29.2, 13.2, 17]) | DOWN}
    return parts | {"sides": _under("z", 18.5) - parts["underside"]}


def _domino() -> Parts:
    parts = {"face": box([-13.7, -28.7, 8], [13.7, 28.7, 11]), "back": DOWN}
    return parts | {"sides": _rest(parts)}


def _mug() -> Parts:
    parts = {"inside": _bar(38, 3, 89.5), "rim": _over("z", 89.5), "handle": _over("x", 40.2)}
    return {"handle": parts["handle"], "body": _rest(parts), "rim": parts["rim"], "inside": parts["inside"]}


def _bowl() -> Parts:
    wall = _middle_of_wall([(20, 4), (36, 10), (50, 26), (55, 48)], 3.4, 8)
    inside = _turned(wall) & _under("z", 45.5)
    parts = {"inside": inside, "rim": _over("z", 45.5), "foot": _under("z", 6.5) - inside}
    return parts | {"body": _rest(parts)}


def _plate() -> Parts:
    wide = Outside(region=_bar(58))
    parts = {"rim": wide, "foot": _under("z", 1.5)}
    above = Facing(direction=np.array([0.0, 0.0, 1.0]), least=0.1)  # the slope towards the rim too
    return parts | {"inside": above - wide, "underside": _rest({**parts, "inside": above})}


def _wine_glass() -> Parts:
    # Between the outer and the inner profile of the generator.
    wall = [(8, 77.5), (13.2, 79.8), (25, 91), (31.9, 108), (31.9, 126), (27.2, 148)]
    parts = {"inside": _turned(wall), "rim": _over("z", 148), "stem": _between("z", 9, 70)}
    parts |= {"foot": _under("z", 9)}
    return parts | {"bowl": _rest(parts)}


def _bottle() -> Parts:
    parts = {"cap": _over("z", 145.8), "neck": _between("z", 132, 145.8)}
    return parts | {"body": _rest(parts)}


def _jar() -> Parts:
    return {"lid": _over("z", 73.9), "body": _under("z", 73.9)}


def _teapot() -> Parts:
    parts = {"handle": _under("x", -47.2), "spout": _over("x", 47.2)}
    parts |= {"knob": _over("z", 79.8), "lid": _bar(28, 69.3, 79.8)}
    parts |= {"body": _rest(parts)}
    return {name: region.moved(0.85, np.zeros(3)) for name, region in parts.items()}


def _pan() -> Parts:
    wall = [point for point in _middle_of_wall([(34, 0), (40, 4), (46, 20)], 2.6, 6) if point[1] > 1.7]
    wall = [[wall[0][0] - 1.0, 1.6], *wall]
    parts = {"handle": _over("x", 45.8), "rim": _over("z", 18.3) & _under("x", 45.8)}
    parts |= {"inside": _turned(wall) - parts["rim"]}
    return parts | {"body": _rest(parts)}


def _spray_bottle() -> Parts:
    trigger = box([15.8, -7, 104], [34, 7, 136.5])
    parts = {"trigger": trigger, "nozzle": _over("x", 38.05) & _over("z", 143)}
    parts |= {"head": _over("z", 120) - parts["trigger"] - parts["nozzle"]}
    parts |= {"collar": _between("z", 105.5, 120) - trigger}
    return parts | {"body": _rest(parts)}


def _hammer() -> Parts:
    head = _over("z", 129)
    parts = {"handle": _under("z", 129), "head": head}
    return parts | {"face": _over("x", 38.8), "claw": head & _under("x", -9)}


def _screwdriver() -> Parts:
    return {"handle": _over("z", 73.9), "shaft": _between("z", 22, 73.9), "blade": _under("z", 22)}


def _wrench() -> Parts:
    return {"shank": _between("x", -38, 44), "large jaw": _under("x", -38), "small jaw": _over("x", 44)}


def _spoon() -> Parts:
    return {"handle": _over("x", 52), "bowl": _under("x", 52)}


def _scissors() -> Parts:
    parts = {"handles": _under("x", -30), "blades": _over("x", 5.5)}
    return parts | {"pivot": _rest(parts)}


def _pen() -> Parts:
    parts = {"tip": _under("z", 22), "barrel": _between("z", 22, 83.9), "cap": _over("z", 83.9)}
    return parts | {"clip": _over("x", 8.05)}


def _dumbbell() -> Parts:
    inner = 35.9  # the heads' inner faces, at 36, are the heads'
    return {
        "grip": _between("x", -inner, inner),
        "left head": _under("x", -inner),
        "right head": _over("x", inner),
    }


def _phone() -> Parts:
    screen = box([-32.6, -70.1, 7.5], [32.6, 70.1, 9])
    parts = {"screen": screen, "camera": _under("z", -0.05), "keys": _over("x", 35.6) | _under("x", -35.6)}
    parts |= {"back": (DOWN & _under("z", 1.0)) - parts["camera"]}
    return parts | {"sides": _rest(parts) & _under("z", 8.3)}


def _flashlight() -> Parts:
    parts = {"lamp": _bar(15.3, 98.5, 113), "button": box([-4, -20, 66], [4, -12.9, 79.5])}
    parts |= {"head": _over("z", 80) - parts["lamp"]}
    return parts | {"body": _rest(parts)}


def _toothbrush() -> Parts:
    parts = {"handle": _under("x", 110), "bristles": box([130, -8, 4.1], [160, 8, 20])}
    parts |= {"head": _over("x", 128) - parts["bristles"]}
    return parts | {"neck": _rest(parts)}


def _bolt() -> Parts:
    return {"head": _over("z", 72.9), "shank": _between("z", 46, 72.9), "thread": _under("z", 46)}


def _nut() -> Parts:
    bore = _bar(13.3)
    return {"flats": Outside(region=bore | UP | DOWN), "bore": bore, "faces": (UP | DOWN) - bore}


def _knob() -> Parts:
    return {"grip": _over("z", 31), "neck": _between("z", 8, 31), "rose": _under("z", 8)}


def _key() -> Parts:
    return {"bow": _under("x", -9), "blade": _over("x", -9)}


def _padlock() -> Parts:
    parts = {"shackle": _over("z", 40.05), "keyhole": _bar(7.6, -2, 7.5)}
    return parts | {"body": _rest(parts)}


def _light_bulb() -> Parts:
    return {"bulb": _over("z", 26), "base": _under("z", 26), "contact": _under("z", 4.9)}


def _hand_wheel() -> Parts:
    parts = {"rim": Outside(region=_bar(38.5)), "hub": _bar(12.3)}
    return parts | {"spokes": _rest(parts)}


def _apple() -> Parts:
    low = cylinder([2.0, 0, 60], [3.6, 0, 68.6], 2.4)
    parts = {"stem": low | _over("z", 68.6)}
    return parts | {"body": _rest(parts)}


def _pear() -> Parts:
    parts = {"stem": _over("z", 92.6)}
    return parts | {"body": _rest(parts)}


def _banana() -> Parts:
    parts = {"stem": _over("x", 54), "tip": _under("x", -62)}
    return parts | {"body": _rest(parts)}


def _dolphin() -> Parts:
    parts = {"beak": _over("x", 57), "tail": _under("x", -60)}
    parts |= {"dorsal fin": _over("z", 17.5)}
    return parts | {"body": _rest(parts)}


_PARTS: dict[str, Callable[[], Parts]] = {
    "cube": _faces, "box": _faces, "prism": _faces, "pyramid": _pyramid, "cylinder": _faces, "cone": _cone,
    "sphere": _sphere, "ring": _ring, "wedge": _wedge, "brick": _brick, "domino": _domino, "mug": _mug,
    "bowl": _bowl, "plate": _plate, "wine_glass": _wine_glass, "bottle": _bottle, "jar": _jar,
    "teapot": _teapot, "pan": _pan, "spray_bottle": _spray_bottle, "hammer": _hammer,
    "screwdriver": _screwdriver, "wrench": _wrench, "spoon": _spoon, "scissors": _scissors, "pen": _pen,
    "dumbbell": _dumbbell, "phone": _phone, "flashlight": _flashlight, "toothbrush": _toothbrush,
    "bolt": _bolt, "nut": _nut, "knob": _knob, "key": _key, "padlock": _padlock, "light_bulb": _light_bulb,
    "hand_wheel": _hand_wheel, "apple": _apple, "pear": _pear, "banana": _banana, "dolphin": _dolphin,
}  # fmt: skip


def _rule(tasks: str, hold_on: str = "", keep_off: str = "") -> PartRule:
    """A rule for some tasks; names of parts are separated by commas."""
    on, off = (tuple(name.strip() for name in names.split(",") if name) for names in (hold_on, keep_off))
    return PartRule(tasks=tuple(tasks.split()), hold_on=on, keep_off=off)


_RULES: dict[str, tuple[PartRule, ...]] = {
    "wedge": (_rule("insert", keep_off="edge"),),
    "bottle": (_rule("screw unscrew", "cap"), _rule("pour", keep_off="cap")),
    "jar": (_rule("screw unscrew", "lid"),),
    "teapot": (_rule("pour", "handle", "spout"),),
    "pan": (_rule("pour shake slide", "handle"),),
    "spray_bottle": (_rule("press", keep_off="trigger, nozzle"),),
    "hammer": (_rule("strike lever pull", "handle", "head"),),
    "screwdriver": (_rule("screw unscrew insert turn", "handle", "blade"),),
    "wrench": (_rule("turn lever pull push", "shank", "large jaw"),),
    "spoon": (_rule("pour turn", "handle", "bowl"),),
    "scissors": (_rule("press", "handles", "blades"),),
    "pen": (_rule("insert slide", keep_off="tip"),),
    "flashlight": (_rule("press", keep_off="lamp, button"),),
    "toothbrush": (_rule("slide", "handle", "bristles"),),
    "bolt": (_rule("screw unscrew turn insert", "head", "thread"),),
    "nut": (_rule("screw unscrew turn", "flats", "bore"),),
    "knob": (_rule("turn twist pull push", "grip", "rose"),),
    "key": (_rule("insert turn pull", "bow", "blade"),),
    "padlock": (_rule("turn", keep_off="keyhole"),),
    "light_bulb": (_rule("screw unscrew", "bulb", "base"),),
    "apple": (_rule("twist pull", keep_off="stem"),),
    "pear": (_rule("twist pull", keep_off="stem"),),
}


@cache
def parts_in_millimetres(name: str) -> tuple[ObjectPart, ...]:
    """The parts of a built-in object in the frame of its generator [mm]."""
    return tuple(
        ObjectPart(name=part, region=region, origin=LIBRARY) for part, region in _PARTS[name]().items()
    )


def part_rules(name: str) -> tuple[PartRule, ...]:
    """Which parts of a built-in object some tasks hold or leave free; empty if its tasks say all."""
    return _RULES.get(name, ())
