"""What a bake is written to: vertex colors in meshes, or lightmaps in images.

An output reads what it needs of the file (`read`), places the points whose light is asked for (`place`), makes colors of
the light (`compute`), both without touching Blender, and puts them into the file (`writing`).
"""

from __future__ import annotations

from dataclasses import replace
from hashlib import blake2b
from math import inf

import bpy
import numpy as np

from ..core.atlas import NoUnwrapper, make_atlas, read_atlas, unpacked_atlas
from ..core.bake import run
from ..core.flats import emitting_polygons
from ..core.groups import make_groups
from ..core.health import Finding
from ..core.layers import PLAIN, layer_colors, luminance, texel_colors
from ..core.lightmap import Texels, average_cut, find_seams, look_up, make_images, make_texels
from ..core.points import Points
from ..core.raycast import RayCaster
from ..core.records import from_arrays, to_arrays
from ..core.remesh import Remesh, triangulated
from ..core.state import ANEW
from ..core.subdivide import Fitting, fit_mesh, longest_edge, remeshed
from .errors import Refused, check_memory
from .images import file_names, image_path, make_image
from .lookup import Lookup
from .remesh import carried_by, carry, make_mesh, piece_of
from .shown import forget_others, show
from .write_result import (
    Copies,
    check_names,
    copies_of_shared,
    copy_names,
    copy_with,
    deleted,
    drop_sources,
    make_room,
    result_copies,
    source_meshes,
    source_of,
    srgb,
    write_layers,
    writing_result,
)

UV_MAP = "Lightmap"
EXPOSURE = "cell_radiosity_exposure"  # property of a mesh or image: the light was multiplied by 2 to this
MOST_UV_MAPS = 8
LONGEST = 62  # bytes of a layer's name: Blender takes 67, and 8-bit copies are called longer
TEXEL_BYTES, PIXEL_BYTES = 700, 100  # that a texel with surface takes in host and cells, and a pixel of an image


class VertexColors:
    """Colors of the meshes' own vertices and corners."""

    domain = property(lambda self: self.options.domain)

    def __init__(self, options):
        self.options = options
        self.place, self.average, self.lightmaps, self.findings, self.exposure = None, None, (), (), None
        self._remade = set()  # Blender's numbers for the copies that were made

    def read(self, context, scene, targets):
        """Check, before any work, that nothing of the user's is in the way, and that what is to be filled is there."""
        names = [name for name, _, _ in layers_of(self.options, groups_of_scene(context, scene, self.options))]
        lookup = Lookup(context.scene)
        check_names(lookup, targets, (*names, *(map(coded, names) if self.options.bytes else ())))
        if self.options.channel:
            name = self.options.channel[0]
            for target in targets:
                colors = lookup.target(target).data.color_attributes
                if name not in colors:
                    there = ", ".join(c.name for c in colors) or "none"
                    raise Refused(f"{target.object}: it has no color attribute {name!r} (it has: {there})")

    copies = staticmethod(copies_of_shared)  # that objects need whose light goes to their own meshes

    def compute(self, result):
        """Make the layers' colors of a Bake."""
        layers = found_layers(self.options, result)
        colors = {name: layer_colors(result, layer, group) for name, layer, group in layers}
        first = next(iter(colors.values()))
        self.exposure = exposure_of(self.options, first[result.points.corner])
        self.encoded = tuple(map(coded, colors)) if self.options.bytes else ()
        self.channel = None
        if self.options.channel:
            name, channel = self.options.channel
            self.channel = (name, "RGBA".index(channel), luminance(first) * 2.0**self.exposure)
        if self.options.bytes:
            colors |= {coded(k): np.clip(v * 2.0**self.exposure, 0.0, 1.0) for k, v in colors.items()}
        self.colors = colors

    def preview(self, bake):
        """What `painting` shows of a Bake whose light is still coming: the first layer, as it stands; None without any."""
        for name, layer, group in found_layers(self.options, bake)[:1]:
            return {name: layer_colors(bake, layer, group)}

    def painting(self, context, targets, preview, step=inf):
        """Show a `preview`, in steps of some `step` seconds."""
        return writing_result(context, preview, targets, self.options.domain, step=step, remade=self._remade)

    def picture(self, result):
        """What a picture of a Bake is colored with: its corners' Radiosity."""
        return layer_colors(result, "Radiosity")

    def writing(self, context, targets, step=inf):
        """Write, in steps of some `step` seconds; returns Findings."""
        findings = yield from writing_result(
            context, self.colors, targets, self.options.domain, self.encoded, self.channel, step, self._remade
        )
        if self.options.bytes:
            lookup, copies = Lookup(context.scene), result_copies(context.scene)
            for target in targets:
                for object in (lookup.target(target), copies.get(target.object)):
                    if object is not None:
                        object.data[EXPOSURE] = self.exposure
        return findings


class FinerColors(VertexColors):
    """Colors of copies of the meshes, or of the meshes themselves, made finer where the light needs it."""

    def __init__(self, options):
        super().__init__(options)
        self.place = self._place

    copies = staticmethod(lambda objects: Copies())  # their finer meshes are their own

    def _place(self, scene, flipped, cells, light, kept=None):
        self._coarse, o = scene, self.options
        if kept:
            self.remesh = from_arrays(Remesh, "remesh", kept)
            return remeshed(scene, self.remesh), from_arrays(Points, "points", kept), kept
        fitting = Fitting.for_scene(scene, o.max_edge, o.min_edge, o.contrast, o.vertices)
        finer, points, self.remesh = yield from fit_mesh(scene, fitting, flipped, cells, light)
        longest = longest_edge(finer)
        if longest > fitting.max_edge * (1 + 1e-6):
            text = f"edges of {longest:.3g} m are left, longer than {fitting.max_edge:.3g} m"
            action = f"{fitting.vertices:.0f} vertices were the most there might be; --vertices sets another limit"
            self.findings = (Finding("subdivision", text, action),)
        return finer, points, {**to_arrays("points", points), **to_arrays("remesh", self.remesh)}

    def preview(self, bake):
        """None: the finer meshes are shown when they are complete."""

    def writing(self, context, targets, step=inf):
        """Write, in steps; returns Findings."""
        findings, fits = [], []
        sources = yield from source_meshes(context, targets, step)
        lookup = Lookup(context.scene)
        if not self.options.in_place:
            make_room(lookup, targets, sources, copy_names(context.scene))
        for target in targets:
            if lookup.over(step):
                yield
                lookup = Lookup(context.scene)
            source = source_of(lookup, target, sources)
            if isinstance(source, Finding):
                findings.append(source)
                continue
            piece = piece_of(self._coarse, self.remesh, target)
            mesh = make_mesh(source, source.name, piece)
            object = lookup.target(target)
            former, carried = object.data, carried_by(object)
            if self.options.in_place:
                findings += self._replace_mesh(object, mesh)
                holder = object
            else:
                holder = copy_with(lookup, target, mesh)
            carry(holder, carried, source, piece)
            if self.options.in_place and former.users == 0:
                name = former.name
                bpy.data.meshes.remove(former)
                mesh.name = name
            fits.append(replace(target, uid=holder.session_uid, first=0, last=len(piece.index), corner=piece.index))
        drop_sources(sources)
        for fit in fits:
            if lookup.over(step):
                yield
                lookup = Lookup(context.scene)
            holder = lookup.target(fit)
            if holder is None:
                findings.append(deleted(fit))
            else:
                self._write(holder.data, fit)
        return tuple(findings)

    def _replace_mesh(self, object, mesh):
        """Give an object another mesh; returns a Finding if its modifiers, and shape keys below them, are in it now."""
        what = "modifiers and shape keys" if object.data.shape_keys else "modifiers"
        object.data = mesh
        if not len(object.modifiers):
            return []
        object.modifiers.clear()
        return [Finding(object.name, f"it had {what}", "they were applied: its mesh is finer than they know")]

    def _write(self, mesh, fit):
        """Write the layers of one finer mesh."""
        colors = {layer: values[fit.corner] for layer, values in self.colors.items()}
        channel = self.channel and (*self.channel[:2], self.channel[2][fit.corner])
        write_layers(mesh, colors, self.options.domain, self.encoded, channel)
        if self.options.bytes:
            mesh[EXPOSURE] = self.exposure


class Lightmaps:
    """Images, and copies of the objects whose materials show them."""

    domain = "TEXEL"

    def __init__(self, options):
        self.options = options
        self.findings, self.lightmaps = (), ()

    def read(self, context, scene, targets):
        """Check that UV maps are there, or that there is room for one, and read them."""
        self.name, self._uv = self.options.uv or UV_MAP, None
        if self.options.uv:
            self._uv = np.zeros((len(scene.corner_vertex), 2))
            sources = run(source_meshes(context, targets))
            try:
                lookup = Lookup(context.scene)
                for target in targets:
                    self._read_uv(target, lookup.mesh(sources[target.object]))
            finally:
                drop_sources(sources)
            return
        lookup = Lookup(context.scene)
        check_names(lookup, targets, (UV_MAP,))
        for target in targets:
            if len(lookup.target(target).data.uv_layers) >= MOST_UV_MAPS:
                raise Refused(f"{target.object}: it has 8 UV maps, as many as there can be; remove one")

    def _read_uv(self, target, mesh):
        layer = mesh.uv_layers.get(self.options.uv)
        if layer is None:
            names = ", ".join(m.name for m in mesh.uv_layers) or "none"
            raise Refused(f"{target.object}: it has no UV map {self.options.uv!r} (it has: {names})")
        uv = np.empty(2 * len(mesh.loops), np.float32)
        layer.uv.foreach_get("vector", uv)
        self._uv[target.first : target.last] = uv.reshape(-1, 2)[target.corner]

    def place(self, scene, flipped, cells, light, kept=None):
        """The texels of the scene's written objects, as `bake` asks for them."""
        yield from ()  # nothing to wait for
        self._scene, o = scene, self.options
        if kept and self._uv is None:
            self.atlas = unpacked_atlas("atlas", kept)
            self._flipped = kept["flipped"]
            return scene, from_arrays(Texels, "points", kept), kept
        layout = dict(density=o.texels_per_meter, size=o.size, together=o.atlas == "scene")
        try:
            if self._uv is None:
                self.atlas = make_atlas(scene, padding=o.padding, **layout)
            else:
                self.atlas = read_atlas(scene, self._uv, **layout)
        except (NoUnwrapper, ValueError) as problem:
            raise Refused(str(problem)) from None
        needed = TEXEL_BYTES * self.atlas.texels + PIXEL_BYTES * float(self.atlas.size.prod(axis=1).sum())
        what = f"the lightmaps have some {self.atlas.texels:.3g} texels of surface; fewer --texels-per-meter, a smaller --size"
        check_memory(needed, o.budget, what)
        if kept:
            if not np.array_equal(self.atlas.place, kept["atlas.place"]):
                raise Refused(f"the UV map {o.uv!r} is not what it was in the state file: {ANEW}")
            self._flipped = kept["flipped"]
            return scene, from_arrays(Texels, "points", kept), kept
        self._flipped, texels = flipped, make_texels(scene, self.atlas, flipped, cells)
        return scene, texels, {**to_arrays("points", texels), **to_arrays("atlas", self.atlas), "flipped": flipped}

    def average(self, texels, light, cells, seed, places):
        """The light of texels that shadows cut, as `bake` asks for it."""
        return average_cut(self._scene, self.atlas, self._flipped, texels, light, cells, seed, places)

    copies = staticmethod(lambda objects: Copies())  # of objects, to show the images, there are some anyhow

    def compute(self, result):
        """Make the images of a Bake."""
        scene, atlas, texels = result.scene, self.atlas, result.points
        caster = RayCaster(scene.vertices, scene.triangles, scene.usable)
        self.seams = find_seams(scene, atlas, self._flipped, caster)
        layers = found_layers(self.options, result)
        self.images = {name: self._make(layer, result, group) for name, layer, group in layers}
        self.exposure = exposure_of(self.options, texel_colors(result, atlas, *layers[0][1:]))
        self.scene = scene
        self._remesh = None if self._uv is not None else triangulated(scene)
        uv = np.zeros((len(scene.triangles), 3, 2), np.float32)
        uv[atlas.triangle] = atlas.uv
        order = np.argsort(scene.triangle_polygon, kind="stable")  # as the remesh has them
        self._triangle_uv = uv[order].reshape(-1, 2)
        self.findings = tuple(Finding(*f) for f in atlas.findings)
        count = np.bincount(texels.image, minlength=len(atlas.names))
        charts = [len(np.unique(atlas.chart[atlas.image == k])) for k in range(len(atlas.names))]
        self.lightmaps = tuple(
            dict(
                of=name, width=int(w), height=int(h), texels=int(n), charts=c,
                unwrap_seconds=atlas.seconds if atlas.unwrapped else None,
            )
            for name, (w, h), n, c in zip(atlas.names, atlas.size, count, charts)
        )  # fmt: skip

    def preview(self, bake):
        """None: images are shown when they are complete."""

    def picture(self, result):
        """What a picture of a Bake is colored with: a function that looks Radiosity up in the images."""
        atlas = self.atlas
        images = self.images.get("Radiosity") or self._make("Radiosity", result)
        row = np.full(len(result.scene.triangles), -1)
        row[atlas.triangle] = np.arange(len(atlas.triangle))

        def color(triangle, weight):
            seen = row[triangle] >= 0
            colors = np.zeros((len(triangle), 3))
            colors[seen] = look_up(atlas, images, row[triangle[seen]], weight[seen])
            return colors

        return color

    def _make(self, layer, result, group=None):
        colors = texel_colors(result, self.atlas, layer, group)
        seams = self.seams.in_one_material() if layer == "Radiosity" else self.seams
        return make_images(self.atlas, result.points, colors.T, seams)

    def writing(self, context, targets, step=inf):
        """Write images and copies, in steps; returns Findings."""
        images, copies = {}, []
        output, files = self.options.output or bpy.data.filepath, file_names(self.atlas.names)
        for layer, pictures in self.images.items():
            for number, name in enumerate(self.atlas.names):
                yield
                path = image_path(output, files[number], layer, self.options.image) if output else None
                images[layer, number] = make_image(f"{name}_{layer}", pictures[number], path, self.options.image)
                if self.options.bytes:
                    encoded = srgb(np.clip(pictures[number] * 2.0**self.exposure, 0.0, 1.0))
                    path = image_path(output, files[number], coded(layer), "png") if output else None
                    copies.append(make_image(f"{name}_{coded(layer)}", encoded, path, "byte"))
                    copies[-1][EXPOSURE] = self.exposure
        findings, sources = [], (yield from source_meshes(context, targets, step))
        lookup = Lookup(context.scene)
        make_room(lookup, targets, sources, copy_names(context.scene))
        for target in targets:
            if lookup.over(step):
                yield
                lookup = Lookup(context.scene)
            source = source_of(lookup, target, sources)
            if isinstance(source, Finding):
                findings.append(source)
                continue
            copy = self._copy(lookup, target, source)
            number = self._image_of(target)
            if number is not None:
                show(copy, (images[next(iter(self.images)), number], self.name))
        drop_sources(sources)
        forget_others([*images.values(), *copies])
        return tuple(findings)

    def _image_of(self, target):
        """Number of the image that an object's light is in; None if it has no triangles."""
        triangles = np.flatnonzero(
            (self.scene.triangle_corner[self.atlas.triangle, 0] >= target.first)
            & (self.scene.triangle_corner[self.atlas.triangle, 0] < target.last)
        )
        return int(self.atlas.image[triangles[0]]) if len(triangles) else None

    def _copy(self, lookup, target, source):
        """The copy of a target's object that holds its lightmap's UV map. source: its mesh as it is rendered."""
        if self._remesh is None:
            return copy_with(lookup, target, source)
        piece = piece_of(self.scene, self._remesh, target)
        copy = copy_with(lookup, target, make_mesh(source, source.name, piece))
        carry(copy, carried_by(lookup.target(target)), source, piece)
        layer = copy.data.uv_layers.new(name=UV_MAP, do_init=False)
        layer.uv.foreach_set("vector", self._triangle_uv[piece.index].reshape(-1))
        return copy


def layers_of(options, groups):
    """(name, layer, group) of all that options ask to write: the layers, and each layer of each group."""
    whole = [(layer, layer, None) for layer in options.layers]
    if groups is None:
        return whole
    lit = [layer for layer in options.layers if layer not in PLAIN]
    return whole + [(layer_of_group(layer, name), layer, g) for layer in lit for g, name in enumerate(groups.names)]


def layer_of_group(layer, group):
    """Name of a layer for the light of one group, shortened if it is longer than Blender takes."""
    name = f"{layer}_{group}".encode()
    if len(name) <= LONGEST:
        return name.decode()
    return f"{name[: LONGEST - 5].decode(errors='ignore')}~{blake2b(name, digest_size=2).hexdigest()}"


def found_layers(options, bake):
    """Those of `layers_of` that a Bake has found what they show of: one that ended early may lack openness, and of one that
    was lit anew nobody knows how far it is off."""
    missing = {"Occlusion": bake.openness is None, "RadiosityError": bake.factors is not None}
    return [each for each in layers_of(options, bake.groups) if not missing.get(each[1])]


def groups_of_scene(context, scene, options):
    """The core's Groups of a scene as it was read, or None."""
    group_of = grouping(context, options)
    return make_groups(scene, group_of, emitting_polygons(scene)) if group_of else None


def grouping(context, options):
    """The function that gives the light group of a lamp's or object's name, or None: its own name, or that of its first
    collection."""
    if options.groups is None:
        return None
    if options.groups == "lamp":
        return lambda name: name
    collections = {o.name: c.name for c in reversed(_collections(context.scene.collection)) for o in c.objects}
    return lambda name: collections.get(name, name)


def _collections(collection):
    """A collection and all below it, in their order."""
    return [collection] + [c for child in collection.children for c in _collections(child)]


def coded(layer):
    """Name of a layer's 8-bit copy."""
    return f"{layer}_8bit"


def exposure_of(options, colors):
    """The exposure of 8-bit copies [stops]: what was asked for, or what keeps 99 % of colors (K, 3) below white; 0 if there
    are none to be made."""
    if not (options.bytes or options.exposure):
        return 0.0
    if options.exposure != "auto":
        return float(options.exposure)
    bright = np.quantile(colors.max(axis=1), 0.99) if len(colors) else 0.0
    return float(-np.log2(bright)) if bright > 0 else 0.0


def make_output(options):
    """The output that options ask for."""
    if options.target == "lightmap":
        return Lightmaps(options)
    return FinerColors(options) if options.mesh == "subdivide" else VertexColors(options)
