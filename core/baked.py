"""What a bake tells while it is under way, and what it gives.

Owns the records `Progress` and `Bake`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .accuracy import Estimate
from .effects import Survey
from .groups import Groups
from .patches import Patches
from .points import Points
from .replicates import Light
from .scene import Scene
from .settings import Settings
from .transport import Solution


@dataclass(frozen=True)
class Progress:
    """Where a bake stands.

    phase: "survey", "patches", "transport", "gather" or "error". done: share of the phase, 0..1.
    seconds: since the bake began. left: seconds, a guess. rays: cast so far.
    round, bound: of the transport. points: gathered so far. error: estimated so far.
    take(): the Bake as it stands, as long as it has not gone on; None before there is light.
    state(): the State as it stands, to carry the bake on from; None before there are patches.
    """

    phase: str
    done: float
    seconds: float
    rays: int = 0
    round: int = 0
    bound: float | None = None
    points: int = 0
    left: float | None = None
    error: float | None = None
    take: Callable | None = field(default=None, repr=False, compare=False)
    state: Callable | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True)
class Bake:
    """A finished bake, or one as it stands: every record of its path, and what it took.

    scene: the one that is written. settings: as they came to be.
    estimate: of its error. converged: the error asked for was reached. floor: it was reached by the cheapest way.
    price: tuple of Price, after the pilot.
    seconds: by phase, and CPU seconds. rays: cast in all. cells: what they used.
    groups: light groups, if they were asked for. by_group: a Light with a channel for each group's.
    factors: (G, 3) by which the groups' strengths were changed, None for none.
    seen: (P,) bool, points that count in the error: on what reflects light.
    openness: (P,) 1 less ambient occlusion, if it was asked for.
    state(): the State, to carry it on from.
    """

    scene: Scene
    settings: Settings
    survey: Survey
    patches: Patches
    points: Points
    solution: Solution
    light: Light
    estimate: Estimate | None = None
    converged: bool = False
    floor: bool = False
    price: tuple = ()
    seconds: dict = field(default_factory=dict)
    rays: int = 0
    cells: dict = field(default_factory=dict)
    groups: Groups | None = None
    by_group: Light | None = None
    openness: np.ndarray | None = None
    seen: np.ndarray | None = None
    factors: np.ndarray | None = None
    state: Callable | None = field(default=None, repr=False, compare=False)
