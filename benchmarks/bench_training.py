"""Training the estimator on the cube set to a mean-square error of 5e-4."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from preshape.hiis.estimator import decode, predict
from preshape.hiis.fuzzy import FuzzySets
from preshape.hiis.learning import seed_experiences, training_set
from preshape.hiis.training import WITHIN, back_propagation, initial_weights, train
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session

from .common import median_of, row


def run() -> list[dict[str, Any]]:
    with Session(":memory:") as session:
        ready = session.prepare(PlanRequest(source="cube", task="lift", hand="utah_mit"))
    seeds = seed_experiences(ready.element, FuzzySets(), enough=3.0)
    x, y = training_set(seeds, ready.hand.u)
    weights = train(x, y)
    seconds = median_of(lambda: train(x, y), 7)
    codes = [decode(predict(weights, xi)) for xi in x]
    right = weights.mean_square_error <= 5e-4 and all(
        np.array_equal(decode(yi).plane, code.plane) for yi, code in zip(y, codes, strict=True)
    )
    start = time.perf_counter()
    back_propagation(x, y, [initial_weights(0, within=WITHIN)], seeds=[0], rates=[0.04], epochs=100)
    plain = time.perf_counter() - start
    base = f"100 epochs of the paper's back-propagation, of which it needs 28032 or more: {plain:.2g} s"
    return [row(f"training, {len(seeds)} samples to 5e-4", seconds, "s", 1.0, base, right)]
