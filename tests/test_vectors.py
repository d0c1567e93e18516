"""Small functions of arrays that all of the core counts on."""

from __future__ import annotations

import numpy as np
import pytest

from cell_radiosity.core.vectors import RUN, doubled_areas, runs


@pytest.mark.parametrize(
    ("count", "how", "sizes"),
    [
        (0, {}, []),
        (RUN, {}, [RUN]),
        (RUN + 1, {}, [RUN, 1]),
        (5, dict(each=3, most=7), [2, 2, 1]),
        (3, dict(each=9, most=7), [1, 1, 1]),
        (3, dict(each=0, most=2), [2, 1]),
        (0, dict(most=0), []),
    ],
)
def test_runs_are_as_many_items_as_may_be_and_leave_none_out(count, how, sizes):
    parts = runs(count, **how)
    assert [part.stop - part.start for part in parts] == sizes
    assert [k for part in parts for k in range(part.start, part.stop)] == list(range(count))


def test_doubled_areas_are_positive_counterclockwise():
    around = np.array([[1.0, 1.0], [4.0, 1.0], [1.0, 3.0]])
    assert doubled_areas(np.stack([around, around[::-1]])).tolist() == [6.0, -6.0]
