"""Blocks of points: what travels with a task is all that it needs, and all that a cell ever has of the points."""

from collections import Counter

import numpy as np
import pytest

from cell_radiosity.core import gather
from cell_radiosity.core.bake import bake, run
from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.points import Block, block_arrays, make_points, pairs
from cell_radiosity.core.settings import Settings

from scenes import Material, box, join_meshes, sheet


def room(n):
    panel = sheet("panel", [(0.3, 0.7, 0.98), (0.7, 0.7, 0.98), (0.7, 0.3, 0.98), (0.3, 0.3, 0.98)], material=1)
    materials = [Material("white", (0.7,) * 3), Material("panel", (0, 0, 0), (30.0,) * 3)]
    return join_meshes([box("room", n=n), panel], materials, written=[True, False])


@pytest.mark.parametrize("own", [[0], [3, 4, 5, 6], [1, 40, 41, 90], range(0, 96, 2), range(96), []])
def test_a_block_has_its_points_their_neighbors_and_the_edges_between(own):
    points, own = make_points(room(4)), np.array(own, np.int32)
    assert len(points) > 96
    block = Block(**block_arrays(points, own))
    here, there = pairs(points, own)
    assert len(block) == len(own)
    assert np.array_equal(block.ids[: len(own)], own)
    assert np.array_equal(np.sort(block.ids), np.union1d(own, there))
    assert np.array_equal(block.edges[0], here)
    assert np.array_equal(block.ids[block.edges[1]], there)
    for name in ("position", "normal", "geometric"):
        assert np.array_equal(getattr(block, name), getattr(points, name)[block.ids])
    alone = Block(**block_arrays(points, own, joined=False))
    assert np.array_equal(alone.ids, own)
    assert len(alone.edges[0]) == 0


class Watched(LocalCells):
    """Cells that tell the most tasks of a kind that waited, the most bytes of one, and those of the arrays for all."""

    def __init__(self):
        super().__init__()
        self.most, self.each, self.held = Counter(), Counter(), {}

    def start(self, arrays):
        super().start(arrays)
        self.held.update({name: np.asarray(array).nbytes for name, array in arrays.items()})

    def submit(self, name, **arguments):
        number = super().submit(name, **arguments)
        self.most[name] = max(self.most[name], sum(task[1] == name for task in self._waiting))
        self.each[name] = max(self.each[name], sum(np.asarray(a).nbytes for a in arguments.values()))
        return number


def test_what_cells_hold_does_not_grow_with_the_points():
    """Of four times as many points no task carries more, no more of them wait, and nothing goes to all cells."""
    found = []
    for n in (48, 96):  # both have more points than one task may
        cells = Watched()
        run(bake(room(n), Settings.for_error(0.05, gather_rays=32, patch_edge=0.2, occlusion=0.1), cells))
        found.append(cells)
    few, many = found
    for name in ("gather", "openness", "control"):
        assert many.most[name] <= LocalCells.flow_each + 1
        assert many.each[name] <= 1.2 * few.each[name]
    grown = {name for name, size in many.held.items() if size > 1.01 * few.held[name]}
    assert {name.split(".")[0] for name in grown} == {"scene", "patches"}  # the mesh itself


def test_no_more_tasks_wait_than_memory_allows():
    """A hundredth of the memory, and half as many tasks at a time: the same bits."""
    found = []
    for memory in (2e9, 4e7):
        cells = Watched()
        settings = Settings.for_error(0.05, gather_rays=32, patch_edge=0.2, memory=memory)
        found.append((cells, run(bake(room(64), settings, cells))))
    (plenty, one), (little, other) = found
    assert plenty.most["gather"] == LocalCells.flow_each
    assert (
        little.most["gather"] * little.each["gather"] < 0.05 * 4e7 < plenty.most["gather"] * plenty.each["gather"] * 1.5
    )
    assert np.array_equal(one.light.indirect, other.light.indirect)


def test_tasks_get_smaller_toward_the_end_and_change_no_bit(monkeypatch):
    """So that cells end together; with tasks of a few points each, where cells would wait for the host, the same light."""

    class Counted(LocalCells):
        def __init__(self):
            super().__init__()
            self.sizes = {}  # of each replicate

        def submit(self, name, **arguments):
            if name == "gather":
                self.sizes.setdefault(arguments["seed"], []).append(len(arguments["degree"]))
            return super().submit(name, **arguments)

    settings, found = Settings.for_error(0.05, gather_rays=64, patch_edge=0.2, pilot_rays=8), []
    monkeypatch.setattr(gather, "LEAST_RAYS", 1 << 13)  # few, as the room is small
    for most in (gather.TASK_RAYS, 1 << 9):
        monkeypatch.setattr(gather, "TASK_RAYS", most)
        cells = Counted()
        found.append((cells.sizes, run(bake(room(32), settings, cells))))
    (sizes, usual), (small, other) = found
    for tasks, many in zip(sizes.values(), small.values(), strict=True):
        assert sum(tasks) == sum(many) == len(usual.points)
        assert tasks == sorted(tasks, reverse=True)
        assert tasks[0] > 2 * tasks[-1]
        assert len(many) > 10 * len(tasks)
    assert np.array_equal(usual.light.direct, other.light.direct)
    assert np.array_equal(usual.light.indirect, other.light.indirect)
