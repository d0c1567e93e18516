"""Random scenes, broken ones and crowded ones: each ends in finite light, in time, and leaves nothing behind."""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import warnings
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
from cases import Baker, audit
from crowded_scenes import crowded_scene, crowded_settings
from random_scenes import random_scene, random_settings

from cell_radiosity.core.cells import LocalCells

from scenes import bake, run

EACH = 50  # scenes of a test
QUICK = 50  # scenes that are not among the heavy ones
HANG = 600  # seconds for a test, or for a process' share of one, after which it ends and says where it was
SHARE = 25  # scenes that a process takes at a time
CROWDED = 100  # crowded scenes of a test
FOUND = (25, 43, 44, 74, 121, 137, 176, 439, 612, 1023, 1039, 1084)  # scenes that once came to grief


def bake_random(seed):
    scene = random_scene(seed)
    baked_well(scene, random_settings(seed, scene))


def bake_crowded(seed):
    baked_well(crowded_scene(seed), crowded_settings(seed), (lambda name: name[:1]) if seed % 8 == 0 else None)


def baked_well(scene, settings, group_of=None):
    before = scene.vertices.copy()
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        baked = run(bake(scene, settings, LocalCells(), group_of=group_of))
    audit(baked)
    np.testing.assert_array_equal(scene.vertices, before)  # the input is as it was
    written = scene.written[baked.points.object]
    assert written.all()


def bake_share(seeds):
    """What a process does: bake scenes one after the other. A scene that fails is named."""
    faulthandler.dump_traceback_later(HANG, exit=True)
    for seed in seeds:
        try:
            bake_random(seed)
        except Exception as error:
            raise AssertionError(f"scene {seed}: {type(error).__name__}: {error}") from error
    faulthandler.cancel_dump_traceback_later()


@pytest.fixture(autouse=True)
def watched():
    faulthandler.dump_traceback_later(HANG, exit=True)
    yield
    faulthandler.cancel_dump_traceback_later()


@pytest.fixture(scope="module")
def processes():
    """As many processes as there are cores: thousands of scenes, each in one of them, from start to end."""
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn")) as made:
        yield made


@pytest.mark.parametrize(
    "first", [pytest.param(n, marks=[pytest.mark.heavy] if n >= QUICK else []) for n in range(0, 300, EACH)]
)
def test_random_scenes(first):
    for seed in range(first, first + EACH):
        bake_random(seed)


@pytest.mark.parametrize("seed", FOUND)
def test_random_scene_that_failed_once(seed):
    bake_random(seed)


@pytest.mark.heavy
@pytest.mark.parametrize("first", range(1000, 10_500, 500))
def test_many_random_scenes(first, processes):
    shares = [range(n, n + SHARE) for n in range(first, first + 500, SHARE)]
    assert sum(map(len, shares)) == 500
    list(processes.map(bake_share, shares))


@pytest.mark.parametrize(
    "first", [pytest.param(0, id="0"), *(pytest.param(n, marks=pytest.mark.heavy) for n in (1000, 1000 + CROWDED))]
)
def test_crowded_scenes(first):
    for seed in range(first, first + (CROWDED if first else 10)):
        bake_crowded(seed)


@pytest.mark.parametrize("seed", range(1, 5))
def test_crowded_scenes_are_the_same_with_any_number_of_cells(seed, cells):
    Baker((LocalCells(), cells))(crowded_scene(seed), **vars(crowded_settings(seed)))
