"""What a bake is given at first for the error asked for: the length of its patches, and its control."""

from __future__ import annotations

from dataclasses import replace
from math import ceil, sqrt

from .accuracy import CERTAIN, ENOUGH, SMALL
from .effects import SHADOWS
from .settings import Settings
from .share import COMMON

EASED = 4.0  # times the length of patches where nothing casts a shadow,
EVEN = 4.0  # and where light is no further from even: see Survey.contrast
FEWER = 0.5  # times the rays of its pilot: light is smooth, and the filter takes most of their noise away
LEAST_PILOT = 4  # rays, of which replicates still tell their noise
FEWER_FROM = 0.015  # the error asked for: below it a third replicate would follow
CLOSE_BELOW = 0.0075  # the error asked for
# At 1 % 634 of the hall's 19 956 vertices were off by more than 5 % of the mean light, and 174 with this; as many as go on below
# the error above would leave 138, and take three times as long for it. At 2 % it was 1224 and is 875.
NEAREST, NEAREST_BELOW = (0.4, 0.7), 0.03
EASED_FROM = 0.01  # the error asked for: below it the longer rows cost more than the patches save
# Patches are one such part of the scene's focus long, with rows of so many rays, from an error of reflected light on, where
# sun and sky cast sharp shadows: what such patches miss is up to 20, 4.5 and 2.6 % of reflected light (measured).
# The last is how many times the usual rays a replicate of the pilot gets: the sky alone takes few of them; where about twice
# as many as the pilot's are needed in all, a third replicate, with test rays of its own, takes longer than they do.
# Before it, in how many places their direct light is tested at least, where most light is direct: a shadow that is missed
# on so long a patch tells there, but twice as many places take nothing more off. Where lamps light a room it does not, and
# tests toward all of them would double the time.
# Sun through a window came to 0.78 % at 1 % with the first of these, in 65 % of the time that the second takes (0.64 %).
COARSE = ((0.3, 12, 8, 4, 0.6), (0.1, 18, 8, 8, 1.0), (0.05, 25, 8, 8, 1.6))
# The same, but only where most light is direct: in a court without a roof patches a 50th long with rows of 32 rays take twice
# the time at 1 %, in a room that the sun shines into through a shaft a quarter more.
LESS_COARSE = (0.03, 35, 16, 8, 1.6)
UNPARTED = 0.6  # error of reflected light from which on the coarsest patches are not cut where surfaces touch
SHARP = 16  # places on patches where their direct light is tested, where every object is to reach the error in sunlight
CONTROL_POINTS = 320
EACH_OBJECT = 24  # of them, if every object is to reach the error
MOST_CONTROL_POINTS = 2000
CONTROL_RAYS = ((0.03, 16), (0.015, 32), (0.0, 64))  # of each truth at first, from an error on
LITTLE = 0.125  # of the light: if less than that is reflected, the errors of as much more of it are looked for
SURE_RAYS = 64  # with so many, doubts far below the error asked for do not matter
MOST_CONTROL_RAYS = 2048  # of few points; half as many, where they are not made few for the sake of each object
UNSURE = 0.7  # of the square of the noise: a doubt above that asks for more control rays
UNSURE_ABOVE = 0.15  # the same, where it decides whether the error asked for is reached
STEP = 0.5  # times as many control rays are worth another look
DEEPER = 2  # bounces more than one
CONTROL_COST = 6  # gather rays that a control ray costs: those of both truths, each with a test ray and one more


def eased(settings, found):
    """Settings with the longest patches and the shortest rows that do, by what the survey found, unless others were
    asked for.

    In a room in which nothing casts a shadow, and no lamp is close to a wall, light varies as slowly as the room is wide, so
    patches several times as long, with rows of twice the rays, do as well. Elsewhere what patches miss counts by the share
    of light that is reflected.
    """
    usual = Settings.for_error(settings.error, per_object=settings.per_object)
    if (settings.patch_edge, settings.row_rays, settings.rows) != (usual.patch_edge, usual.row_rays, "rays"):
        return settings
    if shadowless(found) and settings.error >= EASED_FROM:
        if found.contrast > EVEN:
            return settings
        fewer = FEWER if settings.pilot_rays == usual.pilot_rays and settings.error >= FEWER_FROM else 1.0
        return replace(
            settings,
            patch_edge=EASED * settings.patch_edge,
            row_rays=2 * settings.row_rays,
            pilot_rays=max(ceil(fewer * settings.pilot_rays), min(LEAST_PILOT, settings.pilot_rays)),
        )
    if settings.per_object:  # in a dim object much may be reflected
        return settings
    for least, parts, rays, samples, more in (*COARSE, LESS_COARSE) if found.indirect < COMMON else COARSE:
        if error_of_reflected(settings, found) >= least:
            pilot = settings.pilot_rays
            if pilot == usual.pilot_rays:
                pilot = round(more * pilot)
            samples = max(settings.patch_samples, samples if found.indirect < COMMON else 0)
            return replace(settings, patch_edge=1 / parts, row_rays=rays, pilot_rays=pilot, patch_samples=samples)
    return settings


def sharpened(settings, scene):
    """Settings with as many places on patches where their direct light is tested as every object calls for.

    Where the sun's shadow ends on a patch a few places may all be in it, or none. The whole does not mind; the lintel of a
    window gets most of its light from a few such patches, and was off by 6 % where 2 % was asked for.
    """
    if settings.per_object and any(lamp.kind == "sun" for lamp in scene.lamps):
        return replace(settings, patch_samples=max(settings.patch_samples, SHARP))
    return settings


def error_of_reflected(settings, found):
    """What the error asked for allows reflected light, if all other light were exact; by what the survey found."""
    return settings.error / max(found.indirect, 1e-9)


def obstructed(found):
    """Whether something may stand before what points get light from: a source, or the sky, toward which no test rays go."""
    return found.needs("occlusion") or found.needs("sky")


def parted(settings, found):
    """Whether patches are cut where other surfaces touch them: not if they are the coarsest there are because hardly any
    light is reflected, so that what leaks there does not matter."""
    faint = not settings.per_object and error_of_reflected(settings, found) >= UNPARTED
    return found.needs("occlusion") and not (faint and settings.patch_edge >= 1 / COARSE[0][1])


def shadowless(found):
    """Whether nothing casts a shadow, and no light comes through openings or from images, by what the survey found."""
    return not any(found.needs(name) for name in SHADOWS)


def goes_on(settings):
    """How near rays of fine meshes go on that meet a coarse patch, and how fine these are, in lengths of patches. That mends what
    small things get from what they stand on, and the feet of what stands there, which the whole hardly sees, for up to half of
    the time more; those that are very near, and finer, are most of what is off there, for a twentieth."""
    usual = Settings.for_error(settings.error).patch_edge
    coarse = settings.patch_edge is not None and settings.patch_edge > usual
    if settings.per_object or (settings.error < CLOSE_BELOW and not coarse):
        return 1.0, 1.0
    return NEAREST if settings.error < NEAREST_BELOW and not coarse else (0.0, 0.0)


def finer(wanted, settings):
    """Whether wanted Settings have smaller patches, or longer rows, than others."""
    if wanted.patch_edge is None or settings.patch_edge is None:
        return False
    return wanted.patch_edge < settings.patch_edge or wanted.row_rays > settings.row_rays


def bounces_deeper(settings):
    """By how many bounces more than one the control is deeper than patches that were asked for, if those are longer than
    usual: what they have got of one another is off too."""
    usual = Settings.for_error(settings.error, per_object=settings.per_object).patch_edge
    return DEEPER if settings.patch_edge is None or settings.patch_edge > usual else 0


def control_rays(settings, found):
    """Rays of each truth at first: as many as the error asked for calls for, fewer where little light is reflected; more
    follow where they do not do. found: the Survey."""
    error = settings.error * max(LITTLE / max(found.indirect, 1e-9), 1.0)
    if settings.per_object:
        error = 0.0
    return next(rays for least, rays in CONTROL_RAYS if error >= least)


def control_count(objects=0):
    """How many control points; objects: how many there are, if each is to reach the error, else 0."""
    return min(max(CONTROL_POINTS, EACH_OBJECT * objects), MOST_CONTROL_POINTS)


def more_control(found, settings, rays, doubt, wanted):
    """How many more control rays are to be traced, 0 for none: if too little is known of what replicates share, where
    their noise is small enough, and if rays help. found: the Estimate; rays: of each truth so far; doubt: before the last
    of them, times the fourth root of their number; wanted: rays of another replicate at all points, for each control ray
    so far."""
    # They are of use if they take off more than chance must; of few rays, one may weigh too much.
    helped = found.doubt * sqrt(sqrt(rays)) <= doubt or rays <= SURE_RAYS
    error = settings.error
    # A bake that would end above the error, where that may be chance, has nothing else to try, unless it was told to end.
    helped |= not wanted and settings.gather_rays is None and 0 < found.furthest**2 - error**2 < CERTAIN * found.doubt
    if rays >= MOST_CONTROL_RAYS // (2 if settings.per_object else 1) or found.noise > ENOUGH * error or not helped:
        return 0
    # What is cheaper comes first: to gather more, or to know better whether it must be.
    if 0 < wanted < CONTROL_COST:
        return 0
    # What is known at little cost is known well beside the noise; beyond that, beside what was asked for. A doubt that
    # could take the error above what was asked for has to be smaller.
    square = max(found.noise, SMALL * error if rays >= SURE_RAYS else 0.0) ** 2
    within = 0.0 if wanted else max(error**2 - found.furthest**2, 0.0)
    goal = min(max(within, UNSURE_ABOVE * square), UNSURE * square)
    # As many as are needed: doubt falls about as fast as they grow. What is in doubt of single objects is not in it.
    least = 1 if settings.per_object else STEP
    return int(min(max(found.doubt / max(goal, 1e-300) - 1, least), 1) * rays) if found.doubt > goal else 0
