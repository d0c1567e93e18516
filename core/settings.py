"""What a bake may spend: the knobs of both phases, and the accuracy that sets them."""

from __future__ import annotations

from dataclasses import dataclass

PRESETS = {"draft": 0.10, "good": 0.02, "fine": 0.005}  # relative errors

# Effects of light that a scene may or may not call for, in the order of reports.
EFFECTS = (
    "occlusion", "interreflection", "color", "lamps", "emission", "sky", "textures", "two-sided", "transparency",
    "instances", "islands",
)  # fmt: skip
SCHEDULES = ("dynamic", "paper")


@dataclass(frozen=True)
class Settings:
    """Knobs of a bake.

    error: the relative error asked for. per_object: of every object that is not too dark, not of the whole alone.
    seed: of all sample sequences.
    patch_edge: longest edge of a patch, as a share of the scene's focus; None makes every polygon one patch.
    graded: patches of a polygon that is larger than that may be as long a share of it, and are shorter beside sources.
    row_rays: of a form-factor row. patch_samples: places on a patch where its direct light is tested.
    light_samples: times as many test rays toward sources as usual, at patches and points.
    bounces: of light at most; what more of them would bring is in no bound; None: all.
    gather_rays: of a point; None gathers until the error is reached. pilot_rays: of each of the first replicates.
    seconds: a bake may take, in place of an error to reach; None: any.
    schedule: "dynamic" or "paper". rows: "rays" or "analytic", the estimator of form-factor rows.
    memory: what host and cells together may use [bytes].
    side: whose light is asked for, of each face: "front", "back" or "lit" (the one that gets more).
    occlusion: distance within which ambient occlusion counts [m]; None finds none.
    force: effects that are simulated although nothing calls for them.
    """

    error: float = PRESETS["good"]
    per_object: bool = False
    seed: int = 0
    patch_edge: float | None = 1 / 70
    graded: bool = True
    row_rays: int = 16
    patch_samples: int = 4
    light_samples: float = 1.0
    bounces: int | None = None
    gather_rays: int | None = None
    pilot_rays: int = 8
    seconds: float | None = None
    schedule: str = "dynamic"
    rows: str = "rays"
    memory: float = 4e9
    side: str = "front"
    occlusion: float | None = None
    force: tuple = ()

    @classmethod
    def for_error(cls, error, **others):
        """The knobs that reach a relative error in common interiors. What rows miss all points share, most of all those in
        corners, who see few patches; rows are cheap beside what is gathered."""
        levels = ((0.015, 50, 16), (0.0075, 50, 32), (0.0035, 70, 64), (0.0, 100, 64))
        level = next(k for k, (least, _, _) in enumerate(levels) if error >= least)
        if others.get("per_object"):  # small objects call for finer patches than the whole does
            level = min(level + 1, len(levels) - 1)
        _, parts, rays = levels[level]
        pilot = 5 if error > 0.03 else 8 if error > 0.007 else 13
        knobs = dict(row_rays=rays, patch_edge=1 / parts, pilot_rays=pilot)
        return cls(error=error, **(knobs | others))
