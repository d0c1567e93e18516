"""Steep light: surfaces so near to a source that what they get changes much within a patch, and patches that are finer
there.

Owns the choice of polygons whose patches are made finer. A glowing strip a hand's breadth before a wall lights a stripe of
it many times as brightly as the room: patches wider than the stripe would spread it, and what sees it from nearby would
get too little.
"""

from __future__ import annotations

import numpy as np

from .crowd import make_crowd
from .lights import BALL
from .patches import make_patches
from .vectors import ratio

STEEP = 0.35  # change of light across a patch, in units of what patches get in the mean, from which on it is made finer
MATTERS = 0.15  # mean square of the change where it is steep: below that, patches stay as they are
MOST_CHANGE = 5.0  # that counts there: more of it is on a few patches, which little sees
AGAIN = 2.0  # times the light that sources give patches in the mean they get with what is reflected
FINEST = 0.2  # times as long are patches at the least
MOST_PAIRS = 1 << 24  # of a patch and a piece of a source that are looked at
MOST_MORE, TRIES = 2.0, 3  # times as many patches there may be, or they are made less fine, in so many steps at most


def make_fine_patches(scene, sources, edge, growth):
    """The Patches of a scene, see `make_patches`, shorter where light of Sources falls off steeply; None: nowhere."""
    patches = make_patches(scene, edge, growth)
    crowd = make_crowd(sources, sources.kind <= BALL, scene.diagonal) if sources is not None else None
    if (
        edge is None
        or crowd is None
        or not 0 < len(patches) * len(crowd.members) <= MOST_PAIRS
        or not patches.area.any()
    ):
        return patches
    slope = np.zeros(len(patches))
    size = np.sqrt(patches.area)
    for sign in (1.0, -1.0):
        for k in range(0, len(patches), 4096):
            part = slice(k, k + 4096)
            found = crowd.slope(patches.centroid[part], sign * patches.normal[part], size[part])
            slope[part] = np.maximum(slope[part], found)
    mean = AGAIN * crowd.members.flux() / patches.area.sum()
    change = ratio(slope * np.minimum(size, edge), mean)
    wanted = np.clip(np.sqrt(ratio(STEEP, change)), FINEST, 1.0)
    wanted[change <= STEEP] = 1.0
    steep = np.minimum(np.where(change > STEEP, change, 0.0), MOST_CHANGE)
    if (patches.area * steep * steep).sum() < MATTERS * patches.area.sum():
        return patches
    finer = np.ones(len(scene.polygon_material))
    np.minimum.at(finer, patches.polygon, wanted)
    if (finer == 1.0).all():
        return patches
    for _ in range(TRIES):
        fine = make_patches(scene, edge, growth, finer)
        if len(fine) <= MOST_MORE * len(patches):
            return fine
        finer = np.sqrt(finer)
    return patches
