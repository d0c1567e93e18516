"""The price list: what an error would cost, as the pilot of a bake foretells it.

A bake spends seconds on patches and rows, which grow with their number; on replicates, whose test rays toward sources are
cast however few their gather rays; and on its control. The pilot has measured each: what remains is how much of each an
error calls for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

from .accuracy import AIM, ENOUGH, Estimate, rays_wanted
from .choices import MOST_CONTROL_RAYS, UNSURE, control_rays, eased
from .costs import ROWS
from .effects import Survey
from .patches import count_patches, patch_size
from .scene import Scene
from .settings import Settings

PRICED = (0.1, 0.05, 0.02, 0.01, 0.005)  # errors of the price list
AGAIN = 1.25  # times the rays that a pilot's noise calls for: at its next look a bake may find that there is more to do
ANY_RAYS = 0.9  # of the seconds of a small replicate's test rays: they are spent for whatever number of rays
PAIRS = 0.8  # of the control rays that two truths alone would need: those of many have more pairs
STEADY = 0.4  # of the seconds of patches and rows are spent however many there are (measured)
PATCH_MB = 2e-3  # of a patch in host and cells, with its rows
POINT_MB = 3e-5  # of a point in one more replicate


@dataclass(frozen=True)
class Price:
    """What an error costs: error asked for, wall seconds of survey, patches, transport and gather, memory [MB] of host and
    cells, and gather rays a point, as the pilot foretells them."""

    error: float
    seconds: float
    memory_mb: float
    rays: int


@dataclass(frozen=True)
class Pilot:
    """What the pilot of a bake has found out. patches, points: their numbers; rays: of each point so far, in so many
    replicates. control_rays: of each truth; control_rate: seconds of one more. seconds: {phase: so far}, and
    "replicates", which went to "rays" rays a point. parts: {part of the cells' work: CPU seconds}; solve: those of the
    host's own solve. memory_mb: peak of host and cells so far."""

    scene: Scene
    settings: Settings
    survey: Survey
    estimate: Estimate
    patches: int
    points: int
    rays: int
    replicates: int
    control_rays: int
    control_rate: float
    seconds: dict
    parts: dict
    solve: float
    memory_mb: float


def price_list(pilot, errors=PRICED):
    """A tuple of Price, one for each of the errors."""
    grows = pilot.seconds["patches"] + pilot.seconds["transport"]
    fixed, each = replicate_seconds(pilot)
    prices = []
    for error, work in zip(errors, row_work(pilot, errors)):
        more = int(AGAIN * rays_wanted(pilot.estimate, pilot.rays, error))
        seconds = (STEADY + (1 - STEADY) * work) * grows + pilot.seconds["survey"] + control_seconds(pilot, error)
        seconds += fixed * (more > 0) + each * more
        memory = pilot.memory_mb + PATCH_MB * pilot.patches * (work - 1) + POINT_MB * pilot.points * (more > 0)
        prices.append(Price(error, seconds, memory, pilot.rays + more))
    return tuple(prices)


def replicate_seconds(pilot):
    """Seconds that another replicate takes however few its rays, and that each of its rays takes: most of the test rays
    toward sources are cast in any case."""
    seconds, count = pilot.seconds, max(pilot.replicates, 1)
    tests = pilot.parts.get("sources", 0.0) / max(pilot.parts.get("gather", 0.0), 1e-9)
    fixed = ANY_RAYS * min(tests, 1.0) * seconds["replicates"] / count
    return fixed, (seconds["replicates"] - count * fixed) / max(seconds["rays"], 1e-9)


def control_seconds(pilot, error):
    """Seconds that the control will take more, if an error is to be known that is not there: its doubt falls with its
    rays."""
    if pilot.estimate.total <= ENOUGH * error and error >= pilot.settings.error:
        return 0.0
    have = pilot.control_rays
    wanted = have * pilot.estimate.doubt / (UNSURE * (AIM * error) ** 2)
    rays = max(
        have, control_rays(replace(pilot.settings, error=error), pilot.survey), min(PAIRS * wanted, MOST_CONTROL_RAYS)
    )
    return (rays - have) * pilot.control_rate


def row_work(pilot, errors):
    """What patches and rows cost at the errors, as multiples of what they do at the settings of this bake."""
    if pilot.settings.patch_edge is None:
        return [1.0] * len(errors)
    knobs = [pilot.settings, *(eased(Settings.for_error(error), pilot.survey) for error in errors)]
    sizes = [patch_size(pilot.scene, k) for k in knobs]
    different = sorted(set(sizes))
    count = dict(zip(different, count_patches(pilot.scene, different)))
    # Direct light takes as long as there are patches; rows take longer the longer they are.
    direct = pilot.parts.get("direct", 0.0)
    rows = sum(pilot.parts.get(name, 0.0) for name in ROWS) + pilot.solve
    direct /= max(direct + rows, 1e-9)
    own, *others = (
        (direct + (1 - direct) * sqrt(k.row_rays / knobs[0].row_rays)) * count[s] for k, s in zip(knobs, sizes)
    )
    return [work / max(own, 1.0) for work in others]
