"""The lattices that rows and direct light of patches are sampled with."""

from __future__ import annotations

import numpy as np
import pytest

from cell_radiosity.core.sampling import lattice4


@pytest.mark.parametrize("n", [1, 4, 7, 8, 16, 32, 64, 500])
def test_the_first_axis_of_each_pair_is_spread_evenly(n):
    """Whatever its shift: the place on a patch goes through its elements, and each of n elements gets one of n places."""
    points = lattice4(n)
    assert points.shape == (4, n)
    assert (points >= 0).all()
    assert (points < 1).all()
    for axis in (0, 2):
        assert np.allclose(np.sort(points[axis]) - points[axis].min(), np.arange(n) / n, atol=1e-9)


@pytest.mark.parametrize("n", [8, 16, 32, 64])
def test_both_pairs_fill_the_square(n):
    """Of a grid of n / 2 cells nearly all hold a point: on few lines most would be empty."""
    points, cells = lattice4(n), int(np.sqrt(n / 2))
    for u, v in (points[:2], points[2:]):
        held = np.unique((u * cells).astype(int) * cells + (v * cells).astype(int))
        assert len(held) >= 0.75 * cells * cells
