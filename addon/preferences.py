"""The extension's preferences: what a bake may use on this machine, and the accuracy that new scenes start with."""

from __future__ import annotations

import bpy
from bpy.props import EnumProperty, FloatProperty, IntProperty

from .job import default_cells, default_memory
from .translations import CONTEXT, tr

EXTENSION = __package__.rpartition(".")[0]

PRESET_ITEMS = [
    ("draft", "Draft", "10 % error: a first look"),
    ("good", "Good", "2 % error: noise is hard to see"),
    ("fine", "Fine", "0.5 % error: for final results"),
]


class RADIOSITY_preferences(bpy.types.AddonPreferences):
    """Cells, memory and the default accuracy."""

    bl_idname = EXTENSION

    cells: IntProperty(
        name="Cells",
        description="Processes that share the work of a bake; 0 takes one per processor core",
        default=0, min=0, soft_max=64, max=1024,
    )  # fmt: skip
    memory: FloatProperty(
        name="Memory",
        description="Memory that a bake may use, all its processes together, in gigabytes; 0 takes half of this machine's",
        default=0.0, min=0.0, soft_max=256.0, precision=1, step=50,
    )  # fmt: skip
    preset: EnumProperty(
        name="Default Accuracy",
        description="The accuracy that scenes have until another is chosen in their panel",
        items=PRESET_ITEMS,
        default="good",
        translation_context=CONTEXT,
    )

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "preset")
        row = layout.row()
        row.prop(self, "cells")
        if not self.cells:
            row.label(text=tr("automatic: {}", default_cells()))
        row = layout.row()
        row.prop(self, "memory")
        if not self.memory:
            row.label(text=tr("automatic: {} GB", f"{default_memory() / 1e9:.1f}"))


def preference(name):
    """The value of a preference; its default where the extension is not enabled through Blender's preferences."""
    addon = bpy.context.preferences.addons.get(EXTENSION)
    if addon is not None and addon.preferences is not None:
        return getattr(addon.preferences, name)
    return {"cells": 0, "memory": 0.0, "preset": "good"}[name]


CLASSES = (RADIOSITY_preferences,)
