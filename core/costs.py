"""What effects of light have cost in a bake: CPU seconds, as far as they can be told apart; and what those that were left
out would have cost.

An effect's seconds are those that were spent on it alone or on it with others, so they overlap: test rays are there for
the lamp that they go to, and for what may stand before it. What cannot be told apart has no figure. What was left out is
judged by the work that it would have been, in rays of which this bake has measured the price.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from .effects import SHADOWS

SOURCES = ("lamps", "emission", "sky")  # effects whose sources are sampled
ROWS = ("rows", "analytic", "guided")  # tasks that find where light goes
RAYS = ("direct", "gather", "control", *ROWS)  # tasks that cast rays at patches and points
BY_RAYS = ("interreflection", "sky", "emission")  # effects that call for rays: the first that is needed has them all

# Forced on where they were left out, in the price of the bake's own rays (a dozen rooms of 10 000 vertices at 2 %):
TESTS = 8.0  # rays of a point or patch toward a source, in case something is in the way
CONTACTS = 18.0  # rays of a patch, to find what it touches
PATCH = 6.0  # of a patch that is there at all
ROW = 1.4  # of each ray of a row, which is solved with too
ESCAPE = 0.65  # of a ray that meets nothing
ALPHA = 0.12  # of each ray that has met something, to ask whether it goes on
CHANNELS = 0.11  # of all CPU seconds: two more channels


@dataclass(frozen=True)
class Work:
    """What a bake has done. cpu: its CPU seconds; solve: those of the host's own solve; parts: {part: those of the
    cells}. patches, row_rays: and of each row; usual: (patches, row_rays), were they not eased. pilot_rays: of a point
    in the pilot. sources: how many are sampled; shadowed: of which things cast shadows. reflects: whether any side does."""

    cpu: float
    solve: float
    parts: dict
    rays: int
    points: int
    patches: int
    row_rays: int
    usual: tuple
    pilot_rays: int
    sources: int
    shadowed: int
    reflects: bool

    def spent(self, *names):
        return sum(self.parts.get(name, 0.0) for name in names)


def with_costs(found, work):
    """A Survey whose effects say what they have cost in a bake's Work, or would have."""
    needed = {effect.name for effect in found.effects if effect.needed}
    have, would = _costs(needed, work), _foretold(needed, work)
    effects = (replace(e, seconds=(have if e.needed else would).get(e.name)) for e in found.effects)
    return replace(found, effects=tuple(effects))


def _foretold(needed, work):
    """{effect: CPU seconds} that each would cost alone, if it were forced on."""
    ray = _ray_price(work)

    def rows(patches, rays, traced):
        return patches * (PATCH + ROW * rays * traced) * ray

    traced, patches = "interreflection" in needed, work.usual[0]
    finer = max(rows(*work.usual, traced) - rows(work.patches, work.row_rays, traced), 0.0)
    seconds = {
        "occlusion": (TESTS * work.shadowed * (work.points + patches) + CONTACTS * patches) * ray,
        "interreflection": (ESCAPE * work.pilot_rays * work.points * ray + rows(work.patches, work.row_rays, True))
        * work.reflects,
        "color": CHANNELS * work.cpu,
        "lamps": 0.0,
        "emission": 0.0,
        "sky": 0.0,
        "textures": 0.0,
        "two-sided": 0.5 * work.spent("direct"),
        "transparency": ALPHA * ray * work.rays,
        "instances": 0.0,
        "islands": 0.0,
    }
    return {name: cost + finer * (name in SHADOWS) for name, cost in seconds.items()}


def _ray_price(work):
    """CPU seconds of a ray. Where none is cast at patches and points, what sources give them has taken about as long as a
    ray to each; if that was for nothing, there are the survey's."""
    spent, tried = work.spent(*RAYS), work.rays + work.sources * (work.points + work.patches)
    if spent > 0:
        return spent / max(tried, 1)
    return work.spent("cast") / max(work.rays, 1)


def _costs(needed, work):
    """{effect: CPU seconds} of what can be told."""
    spent = work.spent
    costs = {"occlusion": spent("occlusion", "links", "contacts"), "transparency": spent("transparency")}
    sampled = spent("direct", "sources")
    tested = {name: spent(name) for name in SOURCES if spent(name) > 0}
    if not tested and needed.isdisjoint(
        SOURCES[1:]
    ):  # nothing can stand in the way, and it is clear whose light was found
        tested = {"lamps": 1.0}
    for name, seconds in tested.items():
        costs[name] = sampled * seconds / sum(tested.values())
    first = next((name for name in BY_RAYS if name in needed), None)
    if first:
        cast = max(spent("gather") - spent("sources", "links"), 0.0)
        costs[first] = costs.get(first, 0.0) + spent(*ROWS) + work.solve + cast
    return costs
