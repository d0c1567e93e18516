"""Means over surfaces around points: over how many places, and how they come into the light."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cell_radiosity.core.averages import PLACES, WELL, Averages, places_wanted
from cell_radiosity.core.replicates import Light

AREA = np.array([1.0, 2.0, 3.0])
LIGHT = Light(*np.full((2, 1, 3), 2.0), np.zeros((1, 3)), np.zeros(3), np.ones(3, bool))  # 4 W/m^2 everywhere


def averages(variance, places=PLACES[0]):
    return Averages(np.array([2]), np.array([[5.0]]), np.array([variance]), places)


@pytest.mark.parametrize(
    ("known", "wanted"),
    [
        (None, PLACES[0]),
        (averages(1e9), PLACES[1]),
        (averages(1e9, PLACES[1]), PLACES[2]),
        (averages(1e9, PLACES[-1]), 0),
        (averages(0.0), 0),
    ],
)
def test_means_are_taken_over_more_places_until_they_do_or_there_are_no_more(known, wanted):
    assert places_wanted(known, SimpleNamespace(area=AREA), LIGHT, 0.01) == wanted


@pytest.mark.parametrize(("times", "wanted"), [(0.99, 0), (1.01, PLACES[1])])
def test_means_do_where_their_error_is_a_share_of_the_one_asked_for(times, wanted):
    """Of the light's power, 6 m^2 with the square of 4 W/m^2, one point of 3 m^2 has the whole of the means' variance."""
    least = (WELL * 0.01) ** 2 * 6 * 16 / 3
    assert places_wanted(averages(times * least), SimpleNamespace(area=AREA), LIGHT, 0.01) == wanted


def test_means_take_the_place_of_what_one_place_got_and_are_never_below_zero():
    shown = averages(0.0).in_light(LIGHT, np.array([[1.5]])).direct
    assert np.array_equal(shown, [[2.0, 2.0, 2.0 + 5.0 - 1.5]])
    assert averages(0.0).in_light(LIGHT, np.array([[99.0]])).direct[0, 2] == 0.0
    assert np.array_equal(LIGHT.direct, [[2.0, 2.0, 2.0]])


def test_the_variance_of_means_is_that_of_their_points():
    assert np.array_equal(averages(0.3).variances(3), [0.0, 0.0, 0.3])
