"""Fixtures that all tests share."""

from __future__ import annotations

import numpy as np
import pytest

from cell_radiosity.core.cells import make_cells


@pytest.fixture(scope="session")
def cells():
    """Two warm cells, processes as in a real bake."""
    with make_cells(2) as made:
        assert not made.note
        yield made


@pytest.fixture
def rng():
    return np.random.default_rng(20261124)
