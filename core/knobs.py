"""Knobs: what each of them does alone to the error and the seconds of a bake, the others held where an error has set them.

Owns which settings are to be baked for that, and what is read from errors and seconds: which bakes are the cheapest of
their error, and how steeply the error falls.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log

from .settings import Settings

KNOBS = ("patches", "row rays", "gather rays", "light samples", "bounces")
EDGES = (4.0, 2.0, 0.7)  # times the length of patches; the last makes twice as many
ROW_RAYS = (0.25, 0.5, 2.0)
GATHER_RAYS = LIGHT_SAMPLES = (0.25, 0.5, 2.0, 4.0)
BOUNCES = (0, 1, 2, 4)
CHEAPEST_ROWS, CHEAPEST_GATHER = 2, 2  # rays


@dataclass(frozen=True)
class Turn:
    """Settings with one knob turned. knob: of KNOBS; value: what it is turned to: patches' longest edge as a share of the
    scene's focus, rays of a row or a point, times the usual test rays, or bounces."""

    knob: str
    value: float
    settings: Settings


def turns(settings, rays):
    """The Turns of all knobs that Settings have, as a tuple: some cheaper and some dearer than they are. rays: of a point,
    that the error of the settings has asked for."""
    settings, found = replace(settings, gather_rays=rays), []

    def turn(knob, value, **changed):
        found.append(Turn(knob, value, replace(settings, **changed)))

    if settings.patch_edge is not None:
        for factor in EDGES:
            turn("patches", factor * settings.patch_edge, patch_edge=factor * settings.patch_edge)
    if settings.rows == "rays":
        for count in _counts(settings.row_rays, ROW_RAYS, CHEAPEST_ROWS):
            turn("row rays", count, row_rays=count)
    for count in _counts(rays, GATHER_RAYS, CHEAPEST_GATHER):
        turn("gather rays", count, gather_rays=count, pilot_rays=min(settings.pilot_rays, count // 2))
    for factor in LIGHT_SAMPLES:
        turn("light samples", factor, light_samples=factor)
    if settings.schedule == "dynamic":
        for count in BOUNCES:
            turn("bounces", count, bounces=count)
    return tuple(found)


def knob_values(settings, rays):
    """{knob: value} of all knobs as Settings have them; None stands for all bounces, and for what there is not."""
    edge, rows = settings.patch_edge, settings.row_rays if settings.rows == "rays" else None
    return dict(zip(KNOBS, (edge, rows, rays, settings.light_samples, settings.bounces)))


def frontier(found):
    """Of (seconds, error) pairs those that no other one is both cheaper and better than, as a list, cheapest first."""
    best = []
    for seconds, error in sorted(found):
        if not best or error < best[-1][1]:
            best.append((seconds, error))
    return best


def slope(found):
    """The power of the seconds with which the error falls along the frontier of (seconds, error) pairs: the slope of the
    line that fits them best, both as logarithms. None if they have no two different seconds."""
    points = [(log(seconds), log(error)) for seconds, error in frontier(found) if seconds > 0 and error > 0]
    if len(points) < 2:
        return None
    x, y = (sum(values) / len(points) for values in zip(*points))
    spread = sum((a - x) ** 2 for a, _ in points)
    return sum((a - x) * (b - y) for a, b in points) / spread if spread > 0 else None


def _counts(count, factors, least):
    """Different counts of at least `least`, by factors of another."""
    found = (max(round(factor * count), least) for factor in factors)
    return [c for c in dict.fromkeys(found) if c != count]
