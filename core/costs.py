"""What effects of light have cost in a bake: CPU seconds, as far as they can be told apart.

An effect's seconds are those that were spent on it alone or on it with others, so they overlap: test rays are there for
the lamp that they go to, and for what may stand before it. What cannot be told apart has no figure.
"""

from __future__ import annotations

from dataclasses import replace

SOURCES = ("lamps", "emission", "sky")  # effects whose sources are sampled
ROWS = ("rows", "analytic", "guided")  # tasks that find where light goes
BY_RAYS = ("interreflection", "sky", "emission")  # effects that call for rays: the first that is needed has them all


def with_costs(found, parts, solve):
    """A Survey whose needed effects say what they have cost.

    parts: {part: CPU seconds} as Usage has them; solve: CPU seconds of the host's own solve.
    """
    needed = {effect.name for effect in found.effects if effect.needed}
    costs = {name: seconds for name, seconds in _costs(needed, parts, solve).items() if name in needed}
    return replace(found, effects=tuple(replace(e, seconds=costs.get(e.name)) for e in found.effects))


def _costs(needed, parts, solve):
    """{effect: CPU seconds} of what can be told."""

    def spent(*names):
        return sum(parts.get(name, 0.0) for name in names)

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
        costs[first] = costs.get(first, 0.0) + spent(*ROWS) + solve + cast
    return costs
