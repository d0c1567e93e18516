"""What the last bake of a scene has found and reached, kept with the scene."""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, CollectionProperty, FloatProperty, FloatVectorProperty, IntProperty, StringProperty

from .session import writing

GOALS = (0.05, 0.02, 0.01, 0.005, 0.002, 0.001)  # errors that are offered next
NEXT = 0.7  # of the error reached, which the next one must be below


@writing
def _relight(group, context):
    """Show the result with a light group as it was just set."""
    group.id_data.radiosity.relight()


class RADIOSITY_PG_effect(bpy.types.PropertyGroup):
    """An effect of light, why it was needed or not, and what it has cost, or would have; seconds that are not known are
    -1."""

    needed: BoolProperty()
    reason: StringProperty()
    seconds: FloatProperty(default=-1.0)


class RADIOSITY_PG_finding(bpy.types.PropertyGroup):
    """Something that was found about an object, and what was done."""

    finding: StringProperty()
    action: StringProperty()


class RADIOSITY_PG_group(bpy.types.PropertyGroup):
    """A light group of the last bake, and what its lights were changed by since."""

    strength: FloatProperty(
        name="Strength",
        description="How many times as strong as they were baked the lights of this group are; the lamps themselves stay as they are",
        default=1.0, min=0.0, soft_max=4.0, precision=2, step=5, update=_relight,
    )  # fmt: skip
    color: FloatVectorProperty(
        name="Color",
        description="What the light of this group is colored with, on top of the color that it was baked with",
        subtype="COLOR", default=(1.0, 1.0, 1.0), min=0.0, soft_max=1.0, update=_relight,
    )  # fmt: skip

    @property
    def factor(self):
        """What its light is multiplied by: (r, g, b)."""
        return tuple(self.strength * channel for channel in self.color)


class RADIOSITY_PG_result(bpy.types.PropertyGroup):
    """What the last bake of a scene has found and reached. Figures that are not known are -1."""

    points: IntProperty(default=-1)
    seconds: FloatProperty(default=-1.0)
    error: FloatProperty(default=-1.0)
    asked: FloatProperty(default=-1.0)
    converged: BoolProperty()
    layers: StringProperty()
    worst: StringProperty()
    worst_error: FloatProperty(default=-1.0)
    partial: BoolProperty()
    effects: CollectionProperty(type=RADIOSITY_PG_effect)
    health: CollectionProperty(type=RADIOSITY_PG_finding)
    ignored: CollectionProperty(type=RADIOSITY_PG_finding)
    groups: CollectionProperty(type=RADIOSITY_PG_group)

    @property
    def relit(self):
        """Whether lights are other than they were baked."""
        return any(group.factor != (1.0, 1.0, 1.0) for group in self.groups)

    def goal(self):
        """The error that is worth offering next: None if nothing is known of this one, or rays are of no use."""
        if self.partial:
            return self.asked if self.asked > 0 else None
        if self.error < 0 or not self.converged:
            return None
        return next((error for error in GOALS if error < NEXT * self.error), None)

    def clear(self):
        """Forget the bake."""
        for name in ("points", "seconds", "error", "asked", "converged", "layers", "worst", "worst_error", "partial"):
            self.property_unset(name)
        for found in (self.effects, self.health, self.ignored, self.groups):
            found.clear()

    def note_groups(self, groups):
        """Keep the names of the core's Groups, or None."""
        self.groups.clear()
        for name in groups.names if groups else ():
            self.groups.add().name = name

    def note_estimate(self, bake):
        """Keep what is known of a Bake's error, and which one was asked for."""
        estimate, self.asked = bake.estimate, bake.settings.error
        if estimate is None:
            return
        self.error, self.converged = estimate.furthest, bake.converged
        worst = estimate.worst()
        if worst:
            self.worst, self.worst_error = bake.scene.objects[worst[0]], worst[1]

    def note_survey(self, survey, changed=()):
        """Keep the effects and findings of a Survey, and further findings."""
        for found in (self.effects, self.health, self.ignored):
            found.clear()
        for effect in survey.effects:
            row = self.effects.add()
            row.name, row.needed, row.reason = effect.name, effect.needed, effect.reason
            row.seconds = -1.0 if effect.seconds is None else effect.seconds
        for finding in (*survey.health, *changed):
            row = self.health.add()
            row.name, row.finding, row.action = finding.object, finding.finding, finding.action
        for object, reason in survey.ignored:
            row = self.ignored.add()
            row.name, row.finding = object, reason


CLASSES = (RADIOSITY_PG_effect, RADIOSITY_PG_group, RADIOSITY_PG_finding, RADIOSITY_PG_result)
