"""The filter against a matrix that says the same, however it is cut into blocks."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from cell_radiosity.core import filter as module
from cell_radiosity.core.filter import NEARBY, STEPS, Filter
from cell_radiosity.core.points import Points

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
    monkeypatch.setattr(module, "VALUES", COUNT)
    cut = Filter(points, REACH, links)
    assert (cut.smooth(LIGHT) == expected[0]).all()
    assert (cut.local_mean(LIGHT) == expected[1]).all()


def test_no_more_is_held_than_a_few_rows(monkeypatch):
    """However many rows are filtered, what is made beside the result is a few rows of light at a time."""
    count, rows = 40_000, 30
    start, line = np.arange(count + 1, dtype=np.int32), np.arange(count)
    place = np.column_stack([line, np.zeros((count, 2))]) / count
    up = np.tile((0.0, 0.0, 1.0), (count, 1))
    plain = np.zeros(0)
    ring = Points(place, up, up, plain, plain, plain, start, np.roll(line, 1).astype(np.int32), plain, plain, plain)
    monkeypatch.setattr(module, "VALUES", count)
    filter = Filter(ring, np.ones(count), np.ones(count, bool))
    light = np.ones((rows, count))
    tracemalloc.start()
    try:
        filter.smooth(light)
        assert tracemalloc.get_traced_memory()[1] < (rows + 8) * 8 * count
    finally:
        tracemalloc.stop()
