"""What is said of speed follows from what was measured."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from tools.bench.law import cost_of_bakes, cost_of_samples, exponent, geometric_mean  # noqa: E402


def test_exponent_of_a_power():
    x = np.array([10.0, 100.0, 3000.0])
    assert exponent(x, 7 * x**1.3) == pytest.approx(1.3)


def test_samples_follow_their_law_beyond_what_was_measured():
    """Error 0.4 / sqrt(n), seconds 0.3 + 0.02 n: 1 % takes 1600 samples."""
    runs = [(n, 0.4 / n**0.5, 0.3 + 0.02 * n) for n in (16, 64, 256)]
    samples, seconds = cost_of_samples(runs, 0.01)
    assert samples == pytest.approx(1600)
    assert seconds == pytest.approx(32.3)


def test_there_is_no_less_than_one_sample():
    runs = [(n, 0.02 / n**0.5, 0.1 * n) for n in (4, 16)]
    assert cost_of_samples(runs, 0.05) == pytest.approx((1, 0.1))


def test_cost_between_bakes():
    """Seconds ~ error^-2, so the cost at 1 % is known from bakes at 2 and 0.5 %; a bake that others beat says nothing."""
    law = [(0.02, 1.0), (0.005, 16.0), (0.015, 20.0)]
    assert cost_of_bakes(law, 0.01) == pytest.approx(4.0)
    assert cost_of_bakes(law[::-1], 0.01) == pytest.approx(4.0)


def test_cost_at_the_ends_of_what_was_measured():
    law = [(0.02, 1.0), (0.005, 16.0)]
    assert cost_of_bakes(law, 0.1) == 1.0  # there is no cheaper bake
    assert cost_of_bakes(law, 0.0045) == pytest.approx(16 * (5 / 4.5) ** 2)
    assert cost_of_bakes(law, 0.003) is None
    assert cost_of_bakes([(0.02, 1.0)], 0.018) is None  # of one bake there is no law


def test_mean_of_what_is_known():
    assert geometric_mean([2.0, None, 8.0]) == pytest.approx(4.0)
    assert geometric_mean([None]) is None


def test_a_machine_of_half_the_speed_takes_twice_as_long_for_both():
    pytest.importorskip("bpy")
    from tools.bench.errors import compared

    cycles = {"rate": 8e6, "runs": [{"samples": n, "error": 0.4 / n**0.5, "cpu": 0.1 * n} for n in (16, 64)]}
    fast = {"rate": 8e6, "bakes": [{"error": e, "cpu": 1e-4 / e**2} for e in (0.05, 0.02, 0.005)]}
    slow = {"rate": 4e6, "bakes": [{**b, "cpu": 2 * b["cpu"]} for b in fast["bakes"]]}
    here, there = compared(fast, cycles), compared(slow, cycles)
    assert here["slope"] == pytest.approx(0.5)
    assert [c["ratio"] for c in here["costs"]] == pytest.approx([160.0] * 4)
    assert [c["ratio"] for c in there["costs"]] == pytest.approx([160.0] * 4)
    assert there["costs"][0]["cycles"] == pytest.approx(2 * here["costs"][0]["cycles"])


def test_the_readme_has_the_latest_figures():
    pytest.importorskip("bpy")
    from tools.bench import page

    results = [json.loads(path.read_text()) for path in sorted(page.FOLDER.glob("20*.json"))]
    latest = [r["errors"]["scenes"] for r in results if "errors" in r][-1]
    readme = (ROOT / "README.md").read_text()
    for name, table in page.readme_tables(latest).items():
        assert readme.split(page.MARK.format(name))[1].strip() == table


def test_scenes_of_the_series_have_the_size_they_are_said_to_have(rng):
    pytest.importorskip("bpy")
    from tools.bench import growth

    from scenes import join_meshes

    walls = join_meshes([growth.walls(7)])
    assert walls.triangle_normal_area[1].sum() == pytest.approx(2 * (20 + 15 + 12))
    inward = (walls.triangle_normal_area[0] * (np.array([2, 2.5, 1.5]) - walls.vertices[walls.triangles[:, 0]])).sum(
        axis=1
    )
    assert (inward > 0).all()
    emitters = join_meshes([growth.tiles("glowing", rng.random((50, 3)), 0.5 / 50**0.5, rng)])
    assert len(emitters.polygon_object) == 50
    assert emitters.triangle_normal_area[1].sum() == pytest.approx(1.0)


def test_parts_of_a_bake_add_up(cells):
    """Rays and seconds inside Embree of transport and gather are those of the whole bake, but for what surveys
    it and finds where patches touch things before."""
    pytest.importorskip("bpy")
    from tools.bench.phases import watched

    from scenes import Lamp, Settings, box, join_meshes

    block = box("block", (0.3, 0.3, 0), (0.6, 0.6, 0.4), inward=False)
    scene = join_meshes([box(n=6), block], lamps=[Lamp("point", (1.0,) * 3, (0.5, 0.2, 0.8))])
    before = cells.usage.snapshot()
    found = watched(scene, Settings(), cells)
    for part in found.values():
        assert part["rays"] > 0
        assert 0 < part["embree"] < part["cpu"]
    both = sum(part["rays"] for part in found.values())
    assert 0.3 * (cells.usage.rays - before.rays) < both < cells.usage.rays - before.rays
