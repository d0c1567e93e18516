"""Light of whole surfaces around points, as texels show it: the mean over many places, where one would be chance.

Owns the record `Averages`, how many places they are the means of, and how they come into the light of a bake.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .vectors import ratio

PLACES = (16, 64, 256)  # in a surface over which light is averaged: the first that do
WELL = 0.3  # of the error asked for: averages that are off by less do


@dataclass(frozen=True)
class Averages:
    """Means over surfaces around some points. ids: (K,) of these points. direct: (C, K) light of sampled sources
    [W/m^2]. variance: (K,) of it, all channels together. places: number of places that each is the mean of."""

    ids: np.ndarray
    direct: np.ndarray
    variance: np.ndarray
    places: int

    def in_light(self, light, sampled):
        """A Light with these means in place of what its points have of sampled sources, (C, K)."""
        direct = light.direct.copy()
        direct[:, self.ids] = np.maximum(direct[:, self.ids] + (self.direct - sampled), 0.0)
        return replace(light, direct=direct)

    def variances(self, count):
        """(P,) what the means' own variance adds to that of each of `count` points."""
        more = np.zeros(count)
        more[self.ids] = self.variance
        return more

    def do(self, points, light, error):
        """Whether the means are not what keeps the Light of points from a relative error."""
        area, total = points.area, light.total
        off = ratio((area[self.ids] * self.variance).sum(), (area * (total * total).sum(axis=0)).sum())
        return off < (WELL * error) ** 2


def places_wanted(averages, points, light, error):
    """How many places surfaces are to be averaged over next, 0 if it is not needed; averages: as they are, None before."""
    if averages is None:
        return PLACES[0]
    if averages.do(points, light, error):
        return 0
    return next((places for places in PLACES if places > averages.places), 0)
