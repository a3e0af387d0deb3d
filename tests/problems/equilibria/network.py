"""Cournot firms on a network of five nodes and six lines with limits, and two investments that a planner chooses."""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np

from lcp_plugin import complements

LINES = np.array([(0, 1), (1, 2), (2, 3), (3, 4), (4, 0), (1, 3)])
LIMITS = np.array([3.0, 2.5, 3.0, 2.0, 2.5, 1.5])
INVESTED = [1, 5]  # the lines that may grow
COSTS = np.array(
    [[1.0, 9.0, 9.0, 9.0, 3.0], [9.0, 2.0, 9.0, 4.0, 9.0], [9.0, 9.0, 2.5, 9.0, 9.0]]
)  # firms × nodes
START, SLOPE = np.array([10.0, 12.0, 14.0, 16.0, 11.0]), np.array([1.0, 0.8, 1.2, 0.9, 1.1])
PRICE_OF_LINES = np.array([0.6, 0.9])
MOST_INVESTED = 3.0


def network() -> tuple[cp.Problem, Any]:
    """Return the problem of the largest welfare, of 42 pairs, and the variable of the investments.

    15 outputs and 15 sales of firms at nodes, and two limits of each line; an auctioneer moves energy at the node's
    price of transport.
    """
    firms, nodes = COSTS.shape
    incidence = np.zeros((nodes, len(LINES)))
    incidence[LINES[:, 0], range(len(LINES))], incidence[LINES[:, 1], range(len(LINES))] = -1.0, 1.0
    invested = cp.Variable(2, bounds=[0.0, MOST_INVESTED], name="invested")
    made, sold = (cp.Variable((firms, nodes), nonneg=True) for _ in range(2))
    energy, transport, flow = (
        cp.Variable((firms, 1)),
        cp.Variable((1, nodes)),
        cp.Variable(len(LINES)),
    )
    forth, back = cp.Variable(len(LINES), nonneg=True), cp.Variable(len(LINES), nonneg=True)
    total = cp.sum(sold, axis=0, keepdims=True)
    price = START[None] - cp.multiply(SLOPE[None], total)
    grown = np.zeros((len(LINES), 2))
    grown[INVESTED, [0, 1]] = 1.0
    limit = LIMITS + grown @ invested
    ones = np.ones((firms, 1)), np.ones((1, nodes))
    pairs = [
        complements(
            sold >= 0,
            cp.multiply(np.tile(SLOPE, (firms, 1)), sold)
            + energy @ ones[1]
            + ones[0] @ transport
            - ones[0] @ price
            >= 0,
        ),
        complements(made >= 0, COSTS + 0.2 * made - energy @ ones[1] - ones[0] @ transport >= 0),
        complements(forth >= 0, limit - flow >= 0),
        complements(back >= 0, limit + flow >= 0),
    ]
    rows = [
        cp.sum(sold, axis=1) == cp.sum(made, axis=1),
        cp.vec(cp.sum(sold - made, axis=0), order="F") == incidence @ flow,
        incidence.T @ cp.vec(transport, order="F") == forth - back,
    ]
    welfare = (
        START @ cp.vec(total, order="F")
        - 0.5 * cp.sum(cp.multiply(SLOPE, cp.square(cp.vec(total, order="F"))))
        - cp.sum(cp.multiply(COSTS, made))
        - 0.1 * cp.sum_squares(made)
        - PRICE_OF_LINES @ invested
    )
    return cp.Problem(cp.Maximize(welfare), [*pairs, *rows]), invested
