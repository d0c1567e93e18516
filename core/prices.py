"""The price list: what an error would cost, as the pilot of a bake foretells it.

A bake spends seconds on patches and rows, which grow with their number; on replicates, whose test rays toward sources, if
the noise of direct light calls for any, are cast however few their gather rays; and on its control. The pilot has measured
each: what remains is how much of each an error calls for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, inf, sqrt

from .accuracy import AIM, ENOUGH, Estimate, noise_wanted, rays_tested, rays_wanted
from .choices import MOST_CONTROL_RAYS, UNSURE, control_rays, eased, sharpened
from .control import FEW
from .costs import ROWS
from .effects import Survey
from .patches import count_patches, patch_size
from .scene import Scene
from .settings import Settings

PRICED = (0.1, 0.05, 0.02, 0.01, 0.005)  # errors of the price list
AGAIN = 2  # replicates that follow the pilot, where any do: at its next look a bake finds that there is more to do
ANY_RAYS = 0.9  # of the seconds of a small replicate's test rays: they are spent for whatever number of rays
PAIRS = 0.8  # of the control rays that two truths alone would need: sqrt(m / (2 m - 2)) of m truths, mostly of 4 or 6
MORE_OF_FEW = 1.2  # times as many where few control points have them: their doubt is so much more
PATCH_MB = 1e-3  # of a patch more,
HIT_MB = 4e-5  # and of a ray of its row
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
    """What the pilot of a bake has found out. points, patches: their number; rays: of each so far, in so many replicates.
    control_rays: of each truth, at so many control_points; control_rate: seconds of one more at one of them. seconds:
    {phase: so far}, and "replicates", which went to "rays" rays a point. parts: {part of the cells' work: CPU seconds};
    solve: those of the host's own solve. direct: square of the noise of direct light, as a share of all light."""

    scene: Scene
    settings: Settings
    survey: Survey
    estimate: Estimate
    points: int
    patches: int
    rays: int
    replicates: int
    control_rays: int
    control_points: int
    control_rate: float
    seconds: dict
    parts: dict
    solve: float
    pace: tuple
    memory_mb: float
    direct: float = inf


def price_list(pilot, errors=PRICED):
    """A tuple of Price, one for each of the errors."""
    fixed, each = replicate_seconds(pilot)
    prices = []
    for error, (seconds, memory) in zip(errors, transport_prices(pilot, errors)):
        more = rays_more(pilot, error)
        tested = rays_tested(pilot.direct, pilot.rays, noise_wanted(pilot.estimate, error), more) > 0
        seconds += pilot.seconds["survey"] + control_seconds(pilot, error) + AGAIN * fixed * tested + each * more
        memory += pilot.memory_mb + POINT_MB * pilot.points * AGAIN * (more > 0)
        prices.append(Price(error, seconds, memory, pilot.rays + more))
    return tuple(prices)


def rays_more(pilot, error):
    """How many rays of a point follow those of the pilot. Over many of them variance falls as their number grows: what few
    rays promise, see accuracy.noise_after, is kept in smooth light alone (measured on nine scenes)."""
    goal = noise_wanted(pilot.estimate, error)
    least = rays_wanted(pilot.estimate, pilot.rays, error)
    return max(least, ceil(pilot.rays * (pilot.estimate.noise**2 / goal - 1)))


def replicate_seconds(pilot):
    """Seconds that another replicate with test rays toward sources takes however few its rays, and that each of its rays
    takes: most of the test rays are cast in any case."""
    seconds, count = pilot.seconds, max(pilot.replicates, 1)
    tests = pilot.parts.get("sources", 0.0) / max(pilot.parts.get("gather", 0.0), 1e-9)
    fixed = ANY_RAYS * min(tests, 1.0) * seconds["replicates"] / count
    return fixed, (seconds["replicates"] - count * fixed) / max(seconds["rays"], 1e-9)


def control_seconds(pilot, error):
    """Seconds that the control will take more, if an error is to be known that is not there: its doubt falls with its
    rays. The first that an error calls for go from all control points, others from few."""
    if pilot.estimate.furthest <= ENOUGH * error and error >= pilot.settings.error:
        return 0.0
    have = pilot.control_rays
    wanted = have * pilot.estimate.doubt / (UNSURE * (AIM * error) ** 2)
    first = max(have, control_rays(replace(pilot.settings, error=error), pilot.survey))
    more = max(min(MORE_OF_FEW * PAIRS * wanted, MOST_CONTROL_RAYS) - first, 0)
    points = pilot.control_points
    few = points if pilot.settings.per_object else min(points, FEW)
    return ((first - have) * points + more * few) * pilot.control_rate


def transport_prices(pilot, errors):
    """(seconds of patches and transport, MB more than those of the pilot) at each of the errors.

    Direct light takes as long as there are places on patches where it is tested, rows as long as there are patches, and
    more the longer they are; the rest of what the pilot has taken is spent in any case.
    """
    parts, (host, cells) = pilot.parts, pilot.pace
    spent = pilot.seconds["patches"] + pilot.seconds["transport"]
    if pilot.settings.patch_edge is None:
        return [(spent, 0.0)] * len(errors)
    asked = (Settings.for_error(error, per_object=pilot.settings.per_object) for error in errors)
    knobs = [pilot.settings, *(sharpened(eased(s, pilot.survey), pilot.scene) for s in asked)]
    sizes = [patch_size(pilot.scene, k) for k in knobs]
    different = sorted(set(sizes))
    counts = dict(zip(different, count_patches(pilot.scene, different)))
    own, patches, foretold = knobs[0], max(pilot.patches, 1), max(counts[sizes[0]], 1.0)
    direct = cells * parts.get("direct", 0.0)
    rows = cells * sum(parts.get(name, 0.0) for name in ROWS) + host * pilot.solve
    rest = max(spent - direct - rows, 0.0)
    prices = []
    for knob, size in zip(knobs[1:], sizes[1:]):
        # Many more than foretold come from surfaces in contact and from small faces: finer patches are hardly cut by them.
        count = max(counts[size], patches) if counts[size] >= foretold else patches * counts[size] / foretold
        more, longer = count / patches, knob.row_rays / own.row_rays
        seconds = rest + direct * more * knob.patch_samples / own.patch_samples
        seconds += rows * more * sqrt(longer * sqrt(longer))
        memory = PATCH_MB * (count - patches) + HIT_MB * (count * knob.row_rays - patches * own.row_rays)
        prices.append((seconds, memory))
    return prices
