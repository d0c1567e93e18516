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
NAMES = (*light_scenes.SAMPLES, "door", "small_lamps", "window", "shaft", "courtyard")


def scene_and_reference(name):
    light_scenes.open_scene(name)
    return read_scene(bpy.context)[0], dict(np.load(HERE / "references" / f"{name}.npz"))


@pytest.mark.heavy
@pytest.mark.parametrize("name", NAMES)
def test_the_error_asked_for_is_there_and_known(cells, name):
    """At 5, 2 and 1 %: measured error between 0.4 and 1.1 of what was asked, unless the first rays gave it; the estimate
    within 0.6 to 1.5 of it."""
    scene, reference = scene_and_reference(name)
    for error in (0.05, 0.02, 0.01):
        found = run(bake(scene, Settings.for_error(error), cells))
        measured = off_reference(found, reference)
        assert measured < 1.1 * error, error
        assert found.floor or measured > 0.4 * error, error
        assert 0.6 < found.estimate.total / measured < 1.5, error


@pytest.mark.heavy
def test_hundreds_of_emitting_faces_come_near_the_error_asked_for(cells):
    """Some of them all but touch a wall, whose patches know it only in the mean: the light may be off by a third more than was
    asked for, and how far is in doubt."""
    scene, reference = scene_and_reference("many_emitters")
    for error in (0.05, 0.02):
        found = run(bake(scene, Settings.for_error(error), cells))
        assert len(found.solution.guide)
        assert off_reference(found, reference) < 1.33 * error, error
