"""The filter against a matrix that says the same, however it is cut into blocks."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from cell_radiosity.core import filter as module
from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.filter import NEARBY, STEPS, Filter
from cell_radiosity.core.gather import Gathered, Gathering
from cell_radiosity.core.points import Points
from cell_radiosity.core.replicates import Light, Replicate
from cell_radiosity.core.settings import Settings

COUNT = 60


@pytest.fixture(scope="module")
def points():
    """Points strewn over a plane, each joined to a few others; the first one to most of them, and one to none."""
    random = np.random.default_rng(4)
    joined = random.random((COUNT, COUNT)) < 0.06
    joined[0] = random.random(COUNT) < 0.7
    joined |= joined.T
    joined[np.diag_indices(COUNT)] = joined[7] = joined[:, 7] = False
    normal = np.tile((0.0, 0.0, 1.0), (COUNT, 1))
    normal[40:] = (1.0, 0.0, 0.0)  # a wall, which the floor is not mixed with
    position = np.column_stack([random.random((COUNT, 2)), np.zeros(COUNT)])
    here, there = np.nonzero(joined)
    start = np.searchsorted(here, np.arange(COUNT + 1)).astype(np.int32)
    plain = np.zeros(COUNT)
    return Points(position, normal, normal, plain, plain, plain, start, there.astype(np.int32), plain, plain, plain)


@pytest.fixture(scope="module")
def links(points):
    """Which neighbors see one another: most, the same both ways."""
    here = np.repeat(np.arange(COUNT), np.diff(points.neighbor_start))
    seen = np.random.default_rng(5).random((COUNT, COUNT)) < 0.9
    return (seen | seen.T)[here, points.neighbor]


REACH = np.linspace(0.0, 0.6, COUNT)
LIGHT = np.random.default_rng(6).random((3, COUNT))


def matrices(points, links):
    """One step of the diffusion, and of the mean, as matrices (P, P)."""
    flow, mean = np.zeros((2, COUNT, COUNT))
    degree = np.diff(points.neighbor_start)
    edge = 0
    for here in range(COUNT):
        for there in points.neighbor[points.neighbor_start[here] : points.neighbor_start[here + 1]]:
            if links[edge] and points.normal[here] @ points.normal[there] > 0.95:
                way = np.linalg.norm(points.position[here] - points.position[there])
                share = min(1.0, (min(REACH[here], REACH[there]) / way) ** 2 / 4)
                flow[here, there] = share / max(degree[here], degree[there])
                mean[here, there] = 1.0
            edge += 1
    flow += np.diag(1 - flow.sum(axis=1))
    mean += np.eye(COUNT)
    return flow, mean / mean.sum(axis=1, keepdims=True)


def test_the_filter_is_the_matrix_that_it_stands_for(points, links):
    flow, mean = matrices(points, links)
    most = np.linalg.matrix_power(flow, STEPS - 1)
    whole = (most + most @ flow) / 2
    filter = Filter(points, REACH, links)
    assert np.diff(points.neighbor_start).max() > module.COLUMNS  # some edges are beyond the columns
    assert filter.smooth(LIGHT) == pytest.approx(LIGHT @ (2 * whole - whole @ whole).T, rel=1e-6)
    assert filter.local_mean(LIGHT) == pytest.approx(LIGHT @ np.linalg.matrix_power(mean, NEARBY).T, rel=1e-12)


def test_it_keeps_even_light_and_loses_none(points, links):
    filter = Filter(points, REACH, links)
    assert filter.smooth(np.ones((1, COUNT))) == pytest.approx(1.0, rel=1e-12)
    assert filter.smooth(LIGHT).sum(axis=1) == pytest.approx(LIGHT.sum(axis=1), rel=1e-12)
    assert (filter.smooth(LIGHT)[:, 7] == LIGHT[:, 7]).all()  # it has no neighbors


def test_blocks_do_not_change_a_bit(points, links, monkeypatch):
    whole = Filter(points, REACH, links)
    expected = whole.smooth(LIGHT), whole.local_mean(LIGHT)
    monkeypatch.setattr("cell_radiosity.core.vectors.RUN", 7)
    cut = Filter(points, REACH, links)
    assert (cut.smooth(LIGHT) == expected[0]).all()
    assert (cut.local_mean(LIGHT) == expected[1]).all()


def test_no_more_is_held_than_a_few_rows():
    """However many rows are filtered, what is made beside the result is a few rows of light at a time."""
    count, rows = 40_000, 60
    start, line = np.arange(count + 1, dtype=np.int32), np.arange(count)
    place = np.column_stack([line, np.zeros((count, 2))]) / count
    up = np.tile((0.0, 0.0, 1.0), (count, 1))
    plain = np.zeros(0)
    ring = Points(place, up, up, plain, plain, plain, start, np.roll(line, 1).astype(np.int32), plain, plain, plain)
    filter = Filter(ring, np.ones(count), np.ones(count, bool))
    light = np.ones((rows, count))
    tracemalloc.start()
    try:
        filter.smooth(light)
        assert tracemalloc.get_traced_memory()[1] < (rows + 6 * module.LANES) * 8 * count
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("rays", [(8, 8, 8, 8), (8, 8, 128), (13, 13, 360, 190)])
def test_what_the_filter_does_to_the_light_itself_is_seen_beside_noise(rays):
    """Ripples under noise whose variance falls with the power 3/2 of the rays, as that of lattices does: however unlike
    the replicates are, the parts of the estimate add up to the error that there is."""
    side = 60
    row, column = np.divmod(np.arange(side * side), side)
    steps = [(0, 1), (1, 0), (0, -1), (-1, 0)]
    inside = [np.isin(row + i, row) & np.isin(column + j, column) for i, j in steps]
    neighbor = np.stack([np.arange(side * side) + i * side + j for i, j in steps], axis=1)[np.stack(inside, axis=1)]
    start = np.append(0, np.cumsum(np.sum(inside, axis=0))).astype(np.int32)
    position, plain = np.column_stack([column, row, 0 * row]) / 60.0, np.zeros(side * side)
    normal = np.tile((0.0, 0.0, 1.0), (side * side, 1))
    points = Points(
        position, normal, normal, plain + 1, plain, plain, start, neighbor.astype(np.int32), plain, plain, plain
    )
    truth = 1.0 + 0.05 * np.sin(1.1 * row) * np.sin(1.1 * column)
    random, whole = np.random.default_rng(3), np.ones(side * side, bool)
    zero = np.zeros((1, side * side), np.float32)
    replicates = [
        Replicate(n, n, whole, whole, zero, zero, (truth + random.normal(0, n**-0.75, (1, side * side))), plain + 1)
        for n in rays
    ]
    nothing = Light(zero, zero, zero, plain, ~whole)
    gathered = Gathered(replicates, plain + 1, np.ones(len(neighbor), bool))
    light = Gathering(points, 1, lambda: nothing, LocalCells(), Settings(), gathered=gathered).light(0.1)
    error, noise, blurred = ((light.total - truth) ** 2).mean(), light.variance.mean(), light.blurred.mean()
    assert 0.75 * error < noise + max(blurred, 0.0) < 1.35 * error
