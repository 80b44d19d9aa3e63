"""Hands with every kind of coupling, made from the example hand in ``examples/hands``."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from preshape.hands import load_hand
from preshape.hands.compiled import read_model
from preshape.hands.hand import Hand
from preshape.hands.load import read_description
from preshape.hands.rewrite import rebuilt

EXAMPLE = Path(__file__).parents[1] / "examples" / "hands" / "trident.toml"

CUBIC = {"law": "rigid", "motor": "thumb_knuckle", "follow": {"thumb_middle": [0.4, 0.5, 0.1, 0.05]}}
GEAR = {"law": "rigid", "motor": "ring_knuckle", "follow": {"ring_middle": 0.9}}
SPREAD = {"law": "rigid", "motor": "index_spread", "follow": {"ring_spread": -1.0}}
BENT = {
    "law": "adaptive",
    "motor": "index_tendon",
    "sum": {"index_knuckle": 1.0, "index_middle": 0.5},
    "free": [[-0.5, 0.0], [0.7, 0.2], [1.3, 1.4]],
}
TENDON = {
    "law": "adaptive",
    "motor": "index_tendon",
    "sum": {"index_knuckle": 1.0, "index_middle": 1.0},
    "free": [[0.0, 0.0], [1.3, 1.3]],
    "order": [["index_middle", "index_knuckle"]],
}
LOCKING = {
    "law": "adaptive",
    "motor": "index_tendon",
    "sum": {"index_knuckle": 1.0, "index_middle": 1.0},
    "free": [[0.0, 0.0], [1.3, 0.52]],
    "locks": "index_knuckle",
}


@cache
def coupled_hand(kind: str) -> Hand:
    """The example hand with couples: ``bent``, ``tendon`` or ``locking``; else the hand of that name."""
    index = {"bent": BENT, "tendon": TENDON, "locking": LOCKING}
    if kind not in index:
        return load_hand(kind)
    couples = [CUBIC, GEAR, SPREAD, index[kind]]
    data = {**read_description(EXAMPLE), "name": kind, "couple": couples}
    return rebuilt(data, read_model(EXAMPLE.with_suffix(".urdf")), kind)
