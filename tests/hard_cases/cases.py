"""What a hard case is, and how it is baked: the whole way, with one cell and with two, audited each time."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from scenes import Material, Settings, bake, run

CASES = {}
SETTINGS = dict(gather_rays=128, row_rays=32, patch_edge=1 / 24, error=0.005)


@dataclass(frozen=True)
class Case:
    """A hard case. check: function of a Baker that gives the worst deviation from what must hold, `property`; it must
    not be above `within`. settings: of its bakes, where they are not SETTINGS. heavy: it takes more than 20 seconds."""

    name: str
    property: str
    check: Callable
    within: float
    heavy: bool = False
    settings: dict = field(default_factory=dict)


def case(within, heavy=False, **settings):
    """Make a function a Case, its docstring the property that must hold."""

    def register(check):
        name = check.__name__.replace("_", " ")
        CASES[name] = Case(name, " ".join(check.__doc__.split()), check, within, heavy, settings)
        return check

    return register


class Baker:
    """Bakes scenes, the first with each of several `Cells`, the others, most of them easier twins, with the last of them;
    asserts what must hold of any bake: the same bits from all, finite light that is nowhere below 0, power in balance, no
    warning of numpy's."""

    def __init__(self, cells, **settings):
        self.cells, self.settings = cells, settings
        self.memory = 0.0

    def __call__(self, scene, **settings):
        settings = Settings(**{**SETTINGS, **self.settings, **settings})
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            first, *others = (run(bake(scene, settings, cells)) for cells in self.cells)
        self.cells = self.cells[-1:]
        for other in others:
            assert np.array_equal(first.light.direct, other.light.direct)
            assert np.array_equal(first.light.indirect, other.light.indirect)
            assert np.array_equal(first.points.position, other.points.position)
        self.memory = max(b.cells["host_mb"] + sum(b.cells["cells_mb"]) for b in (first, *others))
        audit(first)
        return first


def audit(baked):
    """Assert what must hold of every bake."""
    light = total(baked)
    assert np.isfinite(light).all()
    assert np.isfinite(baked.points.position).all()
    assert light.min(initial=0.0) >= 0.0
    energy = baked.solution.energy
    assert all(np.isfinite(value) for value in energy.values())
    assert np.isfinite(baked.solution.bound)
    balance = energy["absorbed_w"] + energy["escaped_w"] + energy["unshot_w"]
    np.testing.assert_allclose(balance, energy["emitted_w"], rtol=1e-6, atol=1e-300)


def gray(reflectance, exitance=0.0, name="gray"):
    return Material(name, (reflectance,) * 3, (exitance,) * 3)


def total(baked):
    """(P, C) irradiance at the points of a Bake [W/m^2]."""
    return (baked.light.direct + baked.light.indirect).T


def of(baked, name):
    """(P,) bool: the points of an object."""
    return baked.points.object == baked.scene.objects.index(name)


def off(light, expected, mean=None):
    """The worst deviation of light from what is expected, as a share of the mean that is expected."""
    expected = np.broadcast_to(expected, np.shape(light))
    mean = np.abs(expected).mean() if mean is None else mean
    return float(np.abs(light - expected).max() / mean)


def twin_off(baked, twin, names=None, where=None):
    """The worst deviation of a Bake from that of an easier twin scene, at the points of some objects (None: all of the
    first), as a share of the twin's mean there. where: function of positions (P, 3), the points that count."""
    names = baked.scene.objects if names is None else names
    mine = np.isin(baked.points.object, [baked.scene.objects.index(n) for n in names])
    if where is not None:
        mine &= where(baked.points.position)
    match = nearest(twin.points, baked.points.position[mine], baked.points.normal[mine])
    return off(total(baked)[mine], total(twin)[match])


def nearest(points, position, normal):
    """(K,) the points nearest to places (K, 3) that face the same way."""
    apart = ((points.position[None] - position[:, None]) ** 2).sum(axis=-1)
    turned = 1 - (points.normal[None] * normal[:, None]).sum(axis=-1)
    size = ((points.position.max(axis=0) - points.position.min(axis=0)) ** 2).sum()
    return (apart + size * turned).argmin(axis=1)


def findings(baked, word):
    """The health findings of a Bake with a word in them."""
    return [f for f in baked.survey.health if word in f"{f.finding} {f.action}"]
