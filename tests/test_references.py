"""Bakes of scenes that are hard to light against Cycles: the error asked for is the error that is there, and is known."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("bpy")
sys.path.insert(0, str(Path(__file__).parent.parent))

from cell_radiosity.core.compare import off_reference
from tools.bench.scenes import NAMES, opened, reference_of

from scenes import Settings, bake, run


@pytest.mark.heavy
@pytest.mark.parametrize("name", NAMES)
def test_the_error_asked_for_is_there_and_known(cells, name):
    """At 5, 2 and 1 %: measured error between 0.4 and 1.1 of what was asked, unless the first rays gave it; the estimate
    within 0.6 to 1.5 of it, at the points where references are compared."""
    scene, reference = opened(name), reference_of(name)
    for error in (0.05, 0.02, 0.01):
        found = run(bake(scene, Settings.for_error(error), cells))
        measured = off_reference(found, reference)
        assert measured < 1.1 * error, error
        assert found.floor or measured > 0.4 * error, error
        assert 0.6 < found.estimate.interior / measured < 1.5, error
