"""Settings of a bake, and its prices, kept with each scene."""

from __future__ import annotations

import glob

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)  # fmt: skip

from ..core.layers import LAYERS
from ..core.settings import EFFECTS, PRESETS
from .job import NOTHING, Options
from .marks import KEY, stand_ins
from .preferences import PRESET_ITEMS, preference
from .preflight import price_key
from .relight import relight
from .result import RADIOSITY_PG_result
from .session import writing
from .translations import CONTEXT
from .viewport import show

PRESET_NAMES = [*(item[0] for item in PRESET_ITEMS), "error", "time"]


def _preset(settings):
    """Number of the accuracy chosen for a scene; until one is, the preferences' default."""
    return settings.chosen if settings.chosen >= 0 else PRESET_NAMES.index(preference("preset"))


def _choose_preset(settings, number):
    settings.chosen = number


@writing
def _show(settings, context):
    """Show the result at the exposure that was just set."""
    if settings.shown:
        show(settings.id_data, settings.shown, settings.exposure)


class RADIOSITY_PG_price(bpy.types.PropertyGroup):
    """What an accuracy costs: error asked for, seconds, and memory [MB]."""

    error: FloatProperty()
    seconds: FloatProperty()
    memory: FloatProperty()


class RADIOSITY_PG_settings(bpy.types.PropertyGroup):
    """What the panel asks of a bake."""

    chosen: IntProperty(options={"HIDDEN"}, default=-1)
    preset: EnumProperty(
        name="Accuracy",
        description="How far the light may be off, root mean square over the surface, relative to the light itself",
        items=[
            *PRESET_ITEMS,
            ("error", "Error", "An error of your own"),
            ("time", "Time", "As exact as a time of your own allows"),
        ],
        get=_preset,
        set=_choose_preset,
        translation_context=CONTEXT,
    )
    error: FloatProperty(
        name="Error",
        description="Relative error of the light to reach, root mean square over the surface, in percent",
        subtype="PERCENTAGE", default=2.0, min=0.05, max=100.0, precision=2,
    )  # fmt: skip
    time: FloatProperty(
        name="Time",
        description="How long a bake may take, in seconds, reading and writing left out; the error is as small as that allows",
        subtype="TIME_ABSOLUTE", unit="TIME_ABSOLUTE", default=20.0, min=0.1, soft_max=3600.0, precision=1, step=100,
    )  # fmt: skip
    layers: EnumProperty(
        name="Layers",
        description="What to write, linear and unbounded; Shift-click to choose several",
        items=[
            ("Radiosity", "Radiosity", "What the eye sees: emitted and reflected light"),
            ("Lighting", "Lighting", "The light that arrives, without the surface's own color"),
            ("Direct", "Direct", "The part of Lighting that comes straight from lamps, emitting faces and the sky"),
            ("Indirect", "Indirect", "The part of Lighting that was reflected at least once"),
            ("Occlusion", "Occlusion", "Ambient occlusion: white in the open, dark where something is near"),
            ("RadiosityError", "Error", "How far Lighting may be off at each point: its standard error"),
        ],
        options={"ENUM_FLAG"},
        default={"Radiosity", "Lighting"},
    )
    target: EnumProperty(
        name="Target",
        description="What the light is written to",
        items=[
            ("vertex", "Vertex Colors", "Color attributes of the meshes"),
            ("lightmap", "Lightmaps", "Images, on copies of the objects whose materials show them"),
        ],
        default="vertex",
    )
    mesh: EnumProperty(
        name="Meshes",
        description="Whether meshes are made finer where the light needs it",
        items=[
            ("keep", "Keep", "Meshes stay as they are"),
            ("subdivide", "Make Finer", "Faces are split where the light varies, in copies of the objects"),
        ],
        default="keep",
    )
    max_edge: FloatProperty(
        name="Longest Edge",
        description="Longest edge that is left in finer meshes, in meters; 0 takes 1/40 of the scene's size",
        subtype="DISTANCE", default=0.0, min=0.0, soft_max=10.0,
    )  # fmt: skip
    min_edge: FloatProperty(
        name="Shortest Edge",
        description="Shortest edge that is made in finer meshes, in meters; 0 takes 1/16 of the longest",
        subtype="DISTANCE", default=0.0, min=0.0, soft_max=1.0,
    )  # fmt: skip
    contrast: FloatProperty(
        name="Contrast",
        description="Edges whose ends differ by more than this share of the light are split; 0 takes 0.1",
        default=0.0, min=0.0, soft_max=1.0,
    )  # fmt: skip
    vertices: IntProperty(
        name="Most Vertices",
        description="How many vertices finer meshes may have together; 0 takes a million",
        default=0, min=0,
    )  # fmt: skip
    in_place: BoolProperty(
        name="In Place",
        description="Make the objects' own meshes finer, in place of copies; modifiers are applied",
    )
    occlusion_distance: FloatProperty(
        name="Distance",
        description="How near something must be to count as ambient occlusion",
        subtype="DISTANCE", default=1.0, min=1e-4,
    )  # fmt: skip
    groups: EnumProperty(
        name="Light Groups",
        description="Layers for the light of each group too; all share every ray",
        items=[
            ("none", "None", "Layers of all light together only"),
            ("lamp", "Lamps", "A group for each lamp, each object that emits light, and the sky"),
            ("collection", "Collections", "A group for each collection"),
        ],
        default="none",
    )
    bytes: BoolProperty(
        name="8-Bit Copies",
        description="Also write each layer as 8-bit sRGB colors, which game engines read",
    )
    byte_automatic: BoolProperty(
        name="Automatic Exposure",
        description="Expose 8-bit copies so that 99 % of the light is below white",
        default=True,
    )
    byte_exposure: FloatProperty(
        name="8-Bit Exposure",
        description="Exposure of 8-bit copies and of the channel, in stops",
        default=0.0, soft_min=-10.0, soft_max=10.0, precision=1, step=10,
    )  # fmt: skip
    channel_of: StringProperty(
        name="Channel Of",
        description="Color attribute one of whose channels takes the first layer's brightness; empty for none",
    )
    channel: EnumProperty(
        name="Channel",
        description="The channel that takes the first layer's brightness",
        items=[("R", "Red", "Red"), ("G", "Green", "Green"), ("B", "Blue", "Blue"), ("A", "Alpha", "Alpha")],
        default="A",
    )
    sizing: EnumProperty(
        name="Resolution",
        description="How large lightmaps are",
        items=[
            ("density", "By Density", "As large as a number of texels per meter asks for"),
            ("size", "By Size", "All of one size"),
        ],
        default="density",
    )
    texels_per_meter: FloatProperty(
        name="Texels/Meter",
        description="Texels of a lightmap along a meter of surface",
        default=16.0, min=0.01, soft_min=1.0, soft_max=256.0, precision=1,
    )  # fmt: skip
    size: IntProperty(
        name="Size",
        description="Width and height of each lightmap, in pixels",
        default=1024, min=16, max=16384, subtype="PIXEL",
    )  # fmt: skip
    uv: StringProperty(
        name="UV Map",
        description="UV map that lightmaps lie on; empty unwraps each object into a new map, Lightmap",
    )
    atlas: EnumProperty(
        name="Atlas",
        description="How many lightmaps there are",
        items=[
            ("object", "One per Object", "Each object has lightmaps of its own"),
            ("scene", "One for All", "All objects share one lightmap for each layer"),
        ],
        default="object",
    )
    padding: IntProperty(
        name="Padding",
        description="Texels between the charts of an unwrapped lightmap, so that they do not bleed into each other",
        default=2, min=1, max=64,
    )  # fmt: skip
    image: EnumProperty(
        name="Image",
        description="File format of lightmaps, saved beside the .blend file, or packed into it while it is not saved",
        items=[
            ("exr", "OpenEXR", "32-bit floats, linear and unbounded"),
            ("png", "PNG", "16-bit numbers, linear; the image's custom property scale turns them into light"),
        ],
        default="exr",
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
        description="Write to selected objects only; all visible objects still cast light and shadow",
    )
    side: EnumProperty(
        name="Side",
        description="The side of each face whose light is baked",
        items=[
            ("front", "Front", "The side that the face's normal points to"),
            ("back", "Back", "The other side"),
            ("lit", "Lit", "Of each face the side that gets more light"),
        ],
        default="front",
    )
    shared: EnumProperty(
        name="Shared Meshes",
        description="What to do with meshes that several objects share",
        items=[
            ("copy", "Copy", "Each object gets a mesh of its own with its light"),
            ("skip", "Skip", "They are not written; they still cast light and shadow"),
        ],
        default="copy",
    )
    patch: FloatProperty(
        name="Longest Patch Edge",
        description="Patches are cut until no edge is longer, in meters; 0 takes 1/70 of the scene's size, or 1/100 for fine bakes",
        subtype="DISTANCE", default=0.0, min=0.0, soft_max=10.0,
    )  # fmt: skip
    whole: BoolProperty(
        name="Polygons as Patches",
        description="Take every polygon of the meshes as one patch, however large it is",
    )
    schedule: EnumProperty(
        name="Schedule",
        description="How light is shot between patches",
        items=[
            ("dynamic", "Dynamic", "Batches in flight, rows that are kept, and a solve: the fast way"),
            ("paper", "Paper", "The published host and cell algorithm: one row per cell and round"),
        ],
        default="dynamic",
    )
    rows: EnumProperty(
        name="Form Factors",
        description="How the rows of form factors are found",
        items=[
            ("auto", "Automatic", "As it goes with the schedule"),
            ("rays", "Rays", "Stratified rays: right for many small patches"),
            ("analytic", "Analytic", "Exact factors and shadow rays to every patch: right for few strong ones"),
        ],
        default="auto",
    )
    per_object: BoolProperty(
        name="In Every Object",
        description="Reach the error in every object, dark ones too, and not only over all of them together",
    )
    force: BoolProperty(
        name="Force All Effects",
        description="Simulate every effect of light, also those that the scene does not call for",
    )
    seed: IntProperty(name="Seed", description="Another seed takes other samples of the same light", default=0, min=0)

    exposure: FloatProperty(
        name="Exposure",
        description="Brightness of the result in Solid views, in stops: one more is twice as bright. Baked layers stay as they are",
        default=0.0, soft_min=-10.0, soft_max=10.0, precision=1, step=10, update=_show,
    )  # fmt: skip
    shown: StringProperty(options={"HIDDEN"})
    result: PointerProperty(type=RADIOSITY_PG_result)
    prices: CollectionProperty(type=RADIOSITY_PG_price)
    priced: StringProperty(options={"HIDDEN"})
    edited: BoolProperty(options={"HIDDEN"})

    def relight(self):
        """Show the result with its light groups as they are set."""
        relight(self.id_data, {group.name: group.factor for group in self.result.groups})
        if self.shown and self.exposure:
            show(self.id_data, self.shown, self.exposure)

    def note_prices(self, prices, key, edited=False):
        """Keep what accuracies cost, a tuple of the core's Price. key: what it depends on, see preflight.price_key;
        edited: the scene was changed since it was read."""
        self.prices.clear()
        for price in prices:
            row = self.prices.add()
            row.error, row.seconds, row.memory = price.error, price.seconds, price.memory_mb
        self.priced, self.edited = key, edited

    def prices_hold(self, context):
        """Whether what the price list says is known to be so still."""
        return not self.edited and self.priced == price_key(context, self.options(context))

    def buys(self, price):
        """Whether the accuracy that is chosen is that of a price, or a time the finest one that it pays for."""
        if self.preset == "time":
            error = min((p.error for p in self.prices if p.seconds <= self.time), default=0.0)
            return price.error == error
        error = self.error / 100 if self.preset == "error" else PRESETS[self.preset]
        return abs(error - price.error) < 1e-3 * price.error

    def price_of(self, error):
        """Seconds that an error costs by the price list; None if it does not say."""
        return next((price.seconds for price in self.prices if abs(price.error - error) < 1e-3 * error), None)

    def options(self, context):
        """The Options of a bake with these settings."""
        selected = [o for o in context.selected_objects if o.type == "MESH"] if self.selected else []
        copies = set(stand_ins(context.scene)) if selected else ()
        names = {glob.escape(o[f"{KEY}_of"] if o in copies else o.name) for o in selected}
        return Options(
            error=self.error / 100 if self.preset == "error" else PRESETS.get(self.preset, PRESETS["good"]),
            per_object=self.per_object,
            time=self.time if self.preset == "time" else None,
            layers=tuple(name for name in LAYERS if name in self.layers),
            domain=self.domain,
            objects=(tuple(sorted(names)) or NOTHING) if self.selected else (),
            side=self.side,
            shared=self.shared,
            max_patch="mesh" if self.whole else self.patch or None,
            schedule=self.schedule,
            rows=None if self.rows == "auto" else self.rows,
            memory=1e9 * preference("memory"),
            force=EFFECTS if self.force else (),
            seed=self.seed,
            target=self.target,
            mesh=self.mesh if self.target == "vertex" else "keep",
            max_edge=self.max_edge or None,
            min_edge=self.min_edge or None,
            contrast=self.contrast or None,
            vertices=self.vertices or None,
            in_place=self.in_place,
            occlusion_distance=self.occlusion_distance,
            groups=None if self.groups == "none" else self.groups,
            bytes=self.bytes,
            exposure="auto" if self.bytes and self.byte_automatic else self.byte_exposure,
            channel=(self.channel_of, self.channel) if self.channel_of else None,
            texels_per_meter=self.texels_per_meter,
            size=self.size if self.sizing == "size" else None,
            uv=self.uv or None,
            atlas=self.atlas,
            padding=self.padding,
            image=self.image,
        )


CLASSES = (RADIOSITY_PG_price, RADIOSITY_PG_settings)


def attach():
    """Give every scene its settings."""
    bpy.types.Scene.radiosity = PointerProperty(type=RADIOSITY_PG_settings)


def detach():
    """Take the settings away."""
    del bpy.types.Scene.radiosity
