"""Small systems side by side, and the terms of the functions that are fitted."""

import numpy as np

from isphcli.two_phase.least_squares import TOGETHER, factors, solve_factored, terms_of


def test_each_system_has_its_own_solution():
    """The lower halves are read alone."""
    random = np.random.default_rng(3)
    half, right = random.normal(size=(TOGETHER, 5, 7)), random.normal(size=(5, TOGETHER))
    matrix = np.moveaxis(half @ half.transpose(0, 2, 1), 0, 2)
    given, solution = np.where(np.tri(5, dtype=bool)[:, :, None], matrix, np.nan), right.copy()
    factors(given)
    solve_factored(given, solution)
    for m in range(TOGETHER):
        np.testing.assert_allclose(matrix[:, :, m] @ solution[:, m], right[:, m], atol=1e-12 * np.abs(matrix).max())


def test_products_of_terms_are_powers():
    """1, x, y, x^2 / 2, x y, y^2 / 2 of 2D, and their products among the powers up to the fourth order."""
    powers = [(a, b, c) for order in range(5) for a in range(order, -1, -1) for b in range(order - a, -1, -1)
              for c in [order - a - b]]
    place, pair, scale = terms_of(2, (0, 1, 2))
    terms = [powers[k] for k in place]
    assert terms == [(0, 0, 0), (1, 0, 0), (0, 1, 0), (2, 0, 0), (1, 1, 0), (0, 2, 0)]
    assert scale.tolist() == [1.0, 1.0, 1.0, 0.5, 1.0, 0.5]
    for a, one in enumerate(terms):
        for b, other in enumerate(terms):
            assert powers[pair[a, b]] == tuple(np.add(one, other))
