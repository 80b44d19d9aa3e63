"""The pictures of the README and the documents, drawn by the product itself: `make pictures`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import preshape
from preshape.hand_simulation import hand_geometry
from preshape.objects.library import load_library_object, names
from preshape.pictures import plan_png
from preshape.viewer.gallery import contact_sheet, hand_picture

OUT = Path(__file__).parent / "pictures"


def main() -> None:
    OUT.mkdir(exist_ok=True)
    plan = preshape.plan("mug", "pour", memory=":memory:")
    plan_png(plan, OUT / "plan.png")
    contact_sheet(
        [(load_library_object(name), name) for name in names()], OUT / "library.png", columns=9, cell=150
    )
    hand = preshape.load_hand("utah_mit")
    still = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    hand_picture(hand_geometry(hand, still, hand.posture("rest")), OUT / "utah_mit.png", size=(600, 600))
    for path in sorted(OUT.glob("*.png")):
        print(f"wrote {path.relative_to(OUT.parent.parent)} ({path.stat().st_size // 1024} KiB)")


if __name__ == "__main__":
    main()
