"""Light groups: the light of lamps, glowing objects and the sky, told apart.

Light is linear: groups are further channels of the same transport. They share every patch, row and ray, so many cost
little more than one, and a weighted sum of them is the light of lamps that were turned up or down, without a ray.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

SKY = "World"


@dataclass(frozen=True)
class Groups:
    """G groups. names: (G,). lamp: (L,) the group of each lamp of a scene, object: (O,) of each object's emission, -1 for
    those that give no light; sky: that of the sky, or -1."""

    names: tuple
    lamp: np.ndarray
    object: np.ndarray
    sky: int

    def apart(self, sources, surfaces, sky, owner):
        """Sources, Surfaces and exitance of the sky (C, M) with a channel for each of the G groups' C, group by group.

        owner: (N,) the object of each patch.
        """
        side = self.object[np.repeat(owner, 2)]
        masks = np.stack([side == g for g in range(len(self.names))])
        tiled = {
            name: np.tile(getattr(surfaces, name), (len(self.names), 1)) for name in ("reflectance", "translucency")
        }
        masked = {name: _masked(getattr(surfaces, name), masks) for name in ("sampled", "found")}
        skies = np.concatenate([sky if g == self.sky else np.zeros_like(sky) for g in range(len(self.names))])
        return self.of_sources(sources), replace(surfaces, **tiled, **masked), skies

    def of_sources(self, sources):
        """Sources with a channel for each of the groups'."""
        origin = sources.origin
        group = np.full(len(sources), self.sky)
        group[origin >= 0] = self.lamp[origin[origin >= 0]]
        group[origin < -1] = self.object[-2 - origin[origin < -1]]
        parts = [np.where((group == g)[:, None], sources.strength, 0.0) for g in range(len(self.names))]
        return replace(sources, strength=np.concatenate(parts, axis=1))


def make_groups(scene, group_of, emitting):
    """The Groups of a scene; None if nothing gives light. group_of: function of the name of a lamp, an object, or `SKY`, that gives its group's name.
    emitting: (K,) polygons that emit light."""
    lamps = [group_of(lamp.name) if max(lamp.strength) > 0 else None for lamp in scene.lamps]
    glows = np.zeros(len(scene.objects), bool)
    glows[scene.polygon_object[emitting]] = True
    objects = [group_of(name) if glow else None for name, glow in zip(scene.objects, glows)]
    sky = group_of(SKY) if scene.world.brightest > 0 else None
    names = tuple(dict.fromkeys(name for name in (*lamps, *objects, sky) if name is not None))
    if not names:
        return None
    number = {None: -1, **{name: k for k, name in enumerate(names)}}
    lamp, object = (np.array([number[n] for n in found], int).reshape(-1) for found in (lamps, objects))
    return Groups(names, lamp, object, number[sky])


def _masked(values, masks):
    """(G C, 2 N) values (C, 2 N) where masks (G, 2 N) hold."""
    return (masks[:, None] * values).reshape(-1, values.shape[1])


def one_group(light, groups, number):
    """The Light of one group; light: with a channel for each group's."""
    return replace(light, **{k: _by_group(v, groups)[number] for k, v in _channels(light)})


def weighted(light, groups, factors=None):
    """The Light of all groups together, or with factors (G, 3) of their strength."""
    if factors is not None:
        light = scaled(light, groups, factors)
    return replace(light, **{k: _by_group(v, groups).sum(axis=0) for k, v in _channels(light)})


def scaled(light, groups, factors):
    """A Light with channels for each group, each group's times factors (G, 3) of its strength."""
    factors, count = np.asarray(factors, float)[:, :, None], light.direct.shape[1]
    return replace(light, **{k: (factors * _by_group(v, groups)).reshape(-1, count) for k, v in _channels(light)})


def _channels(light):
    return [(name, getattr(light, name)) for name in ("direct", "indirect")]


def _by_group(values, groups):
    """(G, C, P) of values (G C, P)."""
    return values.reshape(len(groups.names), -1, values.shape[1])
