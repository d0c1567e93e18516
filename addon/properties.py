"""Settings of a bake, kept with each scene."""

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty

from ..core.layers import LAYERS
from ..core.settings import PRESETS
from .job import Options


class RADIOSITY_PG_settings(bpy.types.PropertyGroup):
    """What the panel asks of a bake."""

    preset: EnumProperty(
        name="Accuracy",
        description="How far the light may be off",
        items=[
            ("draft", "Draft", "10 % error: a first look"),
            ("good", "Good", "2 % error: noise is hard to see"),
            ("fine", "Fine", "0.5 % error: for final results"),
            ("error", "Error", "An error of your own"),
        ],
        default="good",
    )
    error: FloatProperty(
        name="Error",
        description="Relative error of the light to reach, root mean square over the surface, in percent",
        subtype="PERCENTAGE", default=2.0, min=0.05, max=100.0, precision=2,
    )  # fmt: skip
    layers: EnumProperty(
        name="Layers",
        description="Color attributes to write",
        items=[
            ("Radiosity", "Radiosity", "What the eye sees: emitted and reflected light"),
            ("Lighting", "Lighting", "The light that arrives, without the surface's own color"),
            ("Direct", "Direct", "The part of Lighting that comes straight from lamps, emitting faces and the sky"),
            ("Indirect", "Indirect", "The part of Lighting that was reflected at least once"),
        ],
        options={"ENUM_FLAG"},
        default={"Radiosity", "Lighting"},
    )
    domain: EnumProperty(
        name="Domain",
        description="Where colors are kept",
        items=[
            ("CORNER", "Face Corner", "Keeps edges between faces sharp"),
            ("POINT", "Vertex", "One color per vertex, the mean over its faces"),
        ],
        default="CORNER",
    )
    selected: BoolProperty(
        name="Selected Only",
        description="Write to selected objects only; all visible objects still cast light",
    )
    seed: IntProperty(name="Seed", description="Of the sample pattern", default=0, min=0)

    # How the running bake stands; the panel shows it.
    progress: FloatProperty(options={"SKIP_SAVE", "HIDDEN"}, default=-1.0)
    status: bpy.props.StringProperty(options={"SKIP_SAVE", "HIDDEN"})

    def options(self, context):
        """The Options of a bake with these settings."""
        objects = tuple(o.name for o in context.selected_objects) if self.selected else ()
        return Options(
            error=PRESETS.get(self.preset, self.error / 100),
            layers=tuple(name for name in LAYERS if name in self.layers),
            domain=self.domain,
            objects=objects,
            seed=self.seed,
        )


CLASSES = (RADIOSITY_PG_settings,)


def attach():
    """Give every scene its settings."""
    bpy.types.Scene.radiosity = PointerProperty(type=RADIOSITY_PG_settings)


def detach():
    """Take the settings away."""
    del bpy.types.Scene.radiosity
