"""Bakes of scenes that are hard to light against Cycles: the error asked for is the error that is there, and is known."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bpy")
sys.path.insert(0, str(Path(__file__).parent.parent))

from cell_radiosity.core.compare import off_reference
from cell_radiosity.core.layers import layer_colors, vertex_means
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


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("name", "error", "most"),
    [
        ("hall", 0.005, 0.004),
        ("sunlit_room", 0.005, 0.004),
        ("cornell_box", 0.005, 0.004),
        ("hall", 0.01, 0.012),
        ("hall", 0.02, 0.05),
    ],
)
def test_hardly_a_vertex_is_off_because_of_where_it_lies(cells, name, error, most):
    """Vertices on creases, in corners and where things touch included: no more than 0.4 % of all are off by more than 5 % of the
    mean light at 0.5 %, 1.2 % at 1 %, and 5 % at 2 %. Points that are not moved off creases, or that read coarse patches at
    their feet, are more."""
    scene, reference = opened(name), reference_of(name)
    found = run(bake(scene, Settings.for_error(error), cells))
    scene, colors = found.scene, layer_colors(found, "Lighting")
    corner_object = np.repeat(scene.polygon_object, np.diff(scene.polygon_start))
    off, light = [], []
    for number, object in enumerate(scene.objects):
        if f"{object}.A" in reference:
            own = corner_object == number
            vertex, (one, other) = scene.corner_vertex[own], (reference[f"{object}.{k}"] for k in ("EA", "EB"))
            mean = vertex_means(colors[own], vertex - vertex.min(), len(one))
            off.append(np.abs(mean - (one + other) / 2).mean(axis=1))
            light.append(reference[f"{object}.A"] * one.mean(axis=1))
    area = sum(reference[key].sum() for key in reference if key.endswith(".A"))
    far = np.concatenate(off) > 0.05 * np.concatenate(light).sum() / area
    assert far.mean() < most
