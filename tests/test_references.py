"""Bakes of scenes that are hard to light against Cycles: the error asked for is the error that is there, and is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import light_scenes  # noqa: E402

from cell_radiosity.addon.read_scene import read_scene  # noqa: E402
from cell_radiosity.core.compare import off_reference  # noqa: E402

from scenes import Settings, bake, run  # noqa: E402

HERE = Path(__file__).parent
ERRORS = (0.05, 0.02, 0.01)
CASES = dict.fromkeys((*light_scenes.SAMPLES, "door", "small_lamps", "window", "shaft", "courtyard"), ERRORS)
CASES["many_emitters"] = (0.05,)  # below, contacts of lights and walls keep it from what is asked


@pytest.mark.heavy
@pytest.mark.parametrize("name", CASES)
def test_the_error_asked_for_is_there_and_known(cells, name):
    """At 5, 2 and 1 %: measured error between 0.4 and 1.1 of what was asked, unless the first rays gave it; the estimate
    within 0.6 to 1.5 of it."""
    light_scenes.open_scene(name)
    scene, _ = read_scene(bpy.context)
    reference = dict(np.load(HERE / "references" / f"{name}.npz"))
    for error in CASES[name]:
        found = run(bake(scene, Settings.for_error(error), cells))
        measured = off_reference(found, reference)
        assert measured < 1.1 * error, error
        assert found.floor or measured > 0.4 * error, error
        assert 0.6 < found.estimate.total / measured < 1.5, error
