"""Every hard case, with one cell and with two."""

from __future__ import annotations

import large
import light
import pytest
import shapes
from cases import CASES, Baker

from cell_radiosity.core.cells import make_cells

MODULES = (large, light, shapes)  # imported for the cases that they register


@pytest.fixture(scope="session")
def one_cell():
    with make_cells(1) as made:
        yield made


@pytest.mark.parametrize(
    "case", [pytest.param(c, id=n, marks=[pytest.mark.heavy] if c.heavy else []) for n, c in CASES.items()]
)
def test_case(case, one_cell, cells):
    assert case.check(Baker((one_cell, cells), **case.settings)) <= case.within
