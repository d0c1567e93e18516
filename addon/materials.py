"""Blender's materials as what the core knows: total reflectance, translucency and exitance.

Owns the reading of shader graphs whose values are constant, or an image as their color. Others are left to
`cycles_read`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import bpy
import numpy as np

from ..core.scene import Material

DEEPEST = 100  # shaders that lead to one another are followed here; Cycles follows longer chains
GLOSS_SHARE = 0.25  # gloss is named when it is more than this share of what a surface reflects
METAL = 0.95  # a metal's reflectance as a share of its base color, after the losses of a rough microfacet surface
LAYER_NAMES = ("Radiosity", "Lighting", "Direct", "Indirect", "Occlusion", "RadiosityError")


class NotConstant(Exception):
    """A value varies over the surface, or comes from a node that is not known here."""


@dataclass(frozen=True)
class _Surface:
    """Shares of the light: reflected diffusely, mirror-like, sent through diffusely; radiance emitted; what a texture adds
    to what is reflected, as a factor of its color; and what passes as if nothing were there."""

    diffuse: np.ndarray
    gloss: np.ndarray
    through: np.ndarray
    emission: np.ndarray
    tint: np.ndarray
    clear: np.ndarray

    def __add__(self, other):
        return _Surface(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def __mul__(self, share):
        return _Surface(*(getattr(self, f.name) * share for f in fields(self)))


def _surface(**parts):
    return _Surface(*(np.asarray(parts.get(f.name, np.zeros(3)), float) for f in fields(_Surface)))


@dataclass(frozen=True)
class Picture:
    """An image that a socket reads. part: "Color" or "Alpha"; inverted: 1 minus it is meant."""

    image: object
    uv_map: str
    part: str = "Color"
    inverted: bool = False


class Graph:
    """What is met in one shader graph: notes on what is left out, and Pictures of its color and its alpha, if any."""

    def __init__(self):
        self.notes, self.texture, self.cut = [], None, None
        self._known, self._depth = {}, 0

    def follow(self, node, read):
        """What `read` makes of a shader node and the graph, once: nodes that many lead to are not read for each of them, which
        would double with every mix of one with itself."""
        if node.name not in self._known:
            if self._depth >= DEEPEST:
                raise NotConstant(f"more than {DEEPEST} shaders in a row")
            self._depth += 1
            self._known[node.name] = read(node, self)
            self._depth -= 1
        return self._known[node.name]

    def use(self, texture):
        if self.texture not in (None, texture):
            raise NotConstant("a second image")
        self.texture = texture
        self._check()

    def cut_by(self, texture):
        if self.cut not in (None, texture):
            raise NotConstant("a second image of alpha")
        self.cut = texture
        self._check()

    def _check(self):
        if self.cut and self.texture and self.cut.uv_map != self.texture.uv_map:
            raise NotConstant("images on two UV maps")


def read_material(material, ignored):
    """The core's Material of a Blender material (None: Blender's default, diffuse 0.8), and the Pictures of its color and
    its alpha, or None each; the textures' numbers are left to the caller.

    ignored: list that takes what is left out, in words. Raises NotConstant if its graph must be baked to be known.
    """
    if material is None:
        return Material(), None, None
    tree = node_tree(material)
    output = tree.get_output_node("CYCLES") if tree else None
    if output is None:
        return viewport_material(material), None, None
    check_plain(tree)
    graph = Graph()
    surface = _shader(_shown_socket(output, tree), graph)
    if output.inputs["Volume"].is_linked:
        graph.notes.append("its volume is left out")
    if output.inputs["Displacement"].is_linked:
        graph.notes.append("its displacement is left out")
    alpha = float(np.clip(1.0 - surface.clear.mean(), 0.0, 1.0))
    if np.ptp(surface.clear) > 0.02:
        graph.notes.append("what passes is tinted: it is taken as gray")
    surface = surface * (1.0 / max(alpha, 1e-6))  # what is there, where rays do not pass
    total = surface.diffuse + surface.gloss
    usual = total + 0.5 * surface.tint
    if surface.gloss.sum() > GLOSS_SHARE * max(usual.sum(), 1e-9):
        share = 100 * surface.gloss.sum() / usual.sum()
        graph.notes.append(f"gloss, {share:.0f} % of what it reflects, is sent on diffusely")
    ignored.extend(f"{material.name}: {note}" for note in graph.notes)
    read = Material(
        material.name,
        reflectance=tuple(total),
        exitance=tuple(np.pi * surface.emission),
        translucency=tuple(surface.through),
        tint=tuple(surface.tint),
        alpha=alpha,
    )
    return read, graph.texture, graph.cut


def read_alpha(material, ignored):
    """Alpha of a Blender material whose color must be baked to be known: the constant, and the Picture or None."""
    tree = node_tree(material)
    output, graph = tree.get_output_node("CYCLES"), Graph()
    try:
        check_plain(tree)
        return _shown_alpha(output.inputs["Surface"], graph), graph.cut
    except NotConstant as problem:
        if any(map(_may_pass, tree.nodes)):
            ignored.append(f"{material.name}: its alpha varies ({problem}): it is taken as opaque")
        return 1.0, None


def _may_pass(node):
    """Whether a node may let rays pass."""
    alpha = node.inputs["Alpha"] if node.type == "BSDF_PRINCIPLED" else None
    return node.type == "BSDF_TRANSPARENT" or bool(alpha and (alpha.is_linked or alpha.default_value < 1.0))


def _shown_alpha(socket, graph):
    """Alpha of a shader socket: of a Principled BSDF, and of mixes with a Transparent BSDF."""
    return graph.follow(socket.links[0].from_node, _node_alpha) if socket.is_linked else 1.0


def _node_alpha(node, graph):
    if node.type == "REROUTE":
        return _shown_alpha(node.inputs[0], graph)
    if node.type == "BSDF_PRINCIPLED":
        return _alpha(node.inputs["Alpha"], graph)
    if node.type == "BSDF_TRANSPARENT":
        return 1.0 - float(node_color(node.inputs["Color"]).mean())
    if node.type == "MIX_SHADER":
        if (cut := _cut_of_mix(node)) is not None:
            graph.cut_by(cut[0])
            return _shown_alpha(cut[1], graph)
        parts = [_shown_alpha(node.inputs[k], graph) for k in (1, 2)]
        if parts == [1.0, 1.0]:
            return 1.0
        share = np.clip(node_value(node.inputs[0]), 0.0, 1.0)
        return float(parts[0] * (1.0 - share) + parts[1] * share)
    return 1.0


def _alpha(socket, graph):
    """The constant alpha of a socket; an image that feeds it is noted in the graph."""
    cut = _image(socket, ("Alpha", "Color"))
    if cut is None:
        return float(np.clip(node_value(socket), 0.0, 1.0))
    graph.cut_by(cut)
    return 1.0


def _cut_of_mix(node):
    """Where a mix's factor is an image and one of its shaders is a clear Transparent BSDF: the Picture of alpha, and the
    socket of the other shader; else None."""
    picture = _image(node.inputs[0], ("Alpha", "Color"))
    if picture is None:
        return None
    for clear, other in ((1, 2), (2, 1)):
        links = node.inputs[clear].links
        if links and links[0].from_node.type == "BSDF_TRANSPARENT" and _is_white(links[0].from_node.inputs["Color"]):
            return replace(picture, inverted=clear == 2), node.inputs[other]
    return None


def _is_white(socket):
    return not socket.is_linked and min(socket.default_value[:3]) > 0.999


def _shown_socket(output, tree):
    """The socket of a material's shader; where an Emission of one of our layers was put in its place to show the
    result, the input that leads to the shader which was there: the one that nothing uses now."""
    socket = output.inputs["Surface"]
    node = socket.links[0].from_node if socket.is_linked else None
    if node is None or node.type != "EMISSION" or not _is_layer(node.inputs["Color"]):
        return socket
    for other in tree.nodes:
        if other.type in SHADERS and other.type not in {"EMISSION", "REROUTE"} and not other.outputs[0].is_linked:
            return _Unlinked(other)
    return socket


class _Unlinked:
    """A shader node that nothing uses, in the form of the socket that it could be linked to."""

    is_linked = True

    def __init__(self, node):
        self.links = [self]
        self.from_node = node


def node_tree(data):
    """The node tree that a material, world or light uses, or None. From Blender 5.0 on materials and worlds always do."""
    if bpy.app.version >= (5, 0, 0) and not isinstance(data, bpy.types.Light):
        return data.node_tree
    return data.node_tree if data.use_nodes else None


def check_plain(tree):
    """Raise NotConstant if a tree's links are not all followed: what is muted or in a circle is Cycles' to understand."""
    if any(node.mute for node in tree.nodes) or any(link.is_muted for link in tree.links):
        raise NotConstant("muted nodes or links")
    if not all(link.is_valid for link in tree.links):
        raise NotConstant("links in a circle")


def viewport_material(material):
    """The core's Material of a Blender material's viewport color."""
    return Material(material.name, tuple(np.clip(material.diffuse_color[:3], 0, 1)))


def _shader(socket, graph):
    """The _Surface of a shader socket."""
    if not socket.is_linked:
        return _surface()
    node = socket.links[0].from_node
    if node.type not in SHADERS:
        raise NotConstant(node.bl_label)
    return graph.follow(node, SHADERS[node.type])


def _principled(node, graph):
    get = {s.name: s for s in node.inputs}
    base, tint = _base(get["Base Color"], graph)
    metal, clear = node_value(get["Metallic"]), node_value(get["Transmission Weight"])
    for name, word in (("Subsurface Weight", "subsurface light"), ("Coat Weight", "a coat"), ("Sheen Weight", "sheen")):
        if name in get and node_value(get[name]) > 0:
            graph.notes.append(f"{word} is left out")
    mirror = _mirror(get)
    opaque = (1.0 - metal) * (1.0 - clear)
    surface = _surface(
        diffuse=base * (1.0 - mirror) * opaque,
        gloss=mirror * (1.0 - metal) + METAL * base * metal + base * (1.0 - mirror) * (1.0 - metal) * clear,
        tint=tint * ((1.0 - mirror) * (1.0 - metal) + METAL * metal),
        emission=np.maximum(_emitted(get["Emission Color"], get["Emission Strength"]), 0.0),
    )
    if clear > 0:
        graph.notes.append("refraction: light that would pass is sent back")
    alpha = _alpha(get["Alpha"], graph)
    return surface * alpha + _surface(clear=np.full(3, 1.0 - alpha))


def _mirror(get):
    """Share of light that a dielectric coat reflects: Fresnel's at right angles, less where it is rough (measured)."""
    ior, rough = node_value(get["IOR"]), np.clip(node_value(get["Roughness"]), 0.0, 1.0)
    level = node_value(get["Specular IOR Level"]) if "Specular IOR Level" in get else 0.5
    tint = np.clip(node_color(get["Specular Tint"]), 0.0, 1.0) if "Specular Tint" in get else np.ones(3)
    fresnel = ((ior - 1.0) / (ior + 1.0)) ** 2 * 2.0 * level
    return np.clip(fresnel * (1.0 - 0.65 * rough**3.5) * tint, 0.0, 1.0)


def _diffuse(node, graph):
    base, tint = _base(node.inputs["Color"], graph)
    return _surface(diffuse=base, tint=tint)


def _glossy(node, graph):
    return _surface(gloss=METAL * np.clip(node_color(node.inputs["Color"]), 0.0, None))


def _glass(node, graph):
    graph.notes.append("refraction: light that would pass is sent back")
    return _surface(gloss=np.clip(node_color(node.inputs["Color"]), 0.0, 1.0))


def _translucent(node, graph):
    return _surface(through=np.clip(node_color(node.inputs["Color"]), 0.0, None))


def _emission(node, graph):
    return _surface(emission=np.maximum(_emitted(node.inputs["Color"], node.inputs["Strength"]), 0.0))


def _mix(node, graph):
    if (cut := _cut_of_mix(node)) is not None:
        graph.cut_by(cut[0])
        return _shader(cut[1], graph)
    share = np.clip(node_value(node.inputs[0]), 0.0, 1.0)
    return _shader(node.inputs[1], graph) * (1.0 - share) + _shader(node.inputs[2], graph) * share


def _add(node, graph):
    return _shader(node.inputs[0], graph) + _shader(node.inputs[1], graph)


def _transparent(node, graph):
    return _surface(clear=np.clip(node_color(node.inputs["Color"]), 0.0, 1.0))


def _reroute(node, graph):
    return _shader(node.inputs[0], graph)


SHADERS = {
    "BSDF_PRINCIPLED": _principled,
    "BSDF_DIFFUSE": _diffuse,
    "BSDF_GLOSSY": _glossy,
    "BSDF_METALLIC": _glossy,
    "BSDF_GLASS": _glass,
    "BSDF_REFRACTION": _glass,
    "BSDF_TRANSLUCENT": _translucent,
    "BSDF_TRANSPARENT": _transparent,
    "EMISSION": _emission,
    "MIX_SHADER": _mix,
    "ADD_SHADER": _add,
    "REROUTE": _reroute,
}


def _emitted(color, strength):
    """Radiance (3,) of an emission; light that a bake wrote and a user hooked up to be seen does not shine again."""
    if _is_layer(color) or _is_layer(strength):
        return np.zeros(3)
    return node_color(color) * node_value(strength)


def _is_layer(socket):
    """Whether a socket is fed by one of our own layers."""
    while socket.is_linked and socket.links[0].from_node.type == "REROUTE":
        socket = socket.links[0].from_node.inputs[0]
    if not socket.is_linked:
        return False
    node = socket.links[0].from_node
    name = getattr(node, "layer_name", None) or getattr(node, "attribute_name", "")
    return node.type in {"VERTEX_COLOR", "ATTRIBUTE"} and name.split("_")[0] in LAYER_NAMES


def _base(socket, graph):
    """The constant color (3,) of a socket and the factor (3,) of the graph's texture; one of them is 0."""
    texture = _image(socket)
    if texture is None:
        return np.clip(node_color(socket), 0.0, 1.0), np.zeros(3)
    graph.use(texture)
    return np.zeros(3), np.ones(3)


def _image(socket, parts=("Color",)):
    """The Picture that feeds a socket as it is, by one of some outputs; or None."""
    node = socket.links[0].from_node if socket.is_linked else None
    if node is None or node.type != "TEX_IMAGE" or socket.links[0].from_socket.name not in parts:
        return None
    if node.image is None or node.image.source not in {"FILE", "GENERATED"} or node.projection != "FLAT":
        return None
    part, vector = socket.links[0].from_socket.name, node.inputs["Vector"]
    if not vector.is_linked:
        return Picture(node.image, "", part)
    feed = vector.links[0].from_node
    if feed.type == "UVMAP":
        return Picture(node.image, feed.uv_map, part)
    if feed.type == "TEX_COORD" and vector.links[0].from_socket.name == "UV":
        return Picture(node.image, "", part)
    return None


def unread_images(tree):
    """The images that nodes of a tree show and that cannot be read."""
    shown = {n.image for n in tree.nodes if n.type in {"TEX_IMAGE", "TEX_ENVIRONMENT"} and n.image} if tree else ()
    return sorted((image for image in shown if not all(image.size)), key=lambda image: image.name)


def read_pixels(picture, largest=1024):
    """The core's pixels (height, width, 3) of a Picture, linear float32, averaged down to `largest` on a side."""
    image = picture.image
    width, height = image.size
    if not width or not height:
        return np.full((1, 1, 3), (1.0, 0.0, 1.0) if picture.part == "Color" else 1.0, np.float32)  # a missing file
    pixels = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height, width, image.channels)
    if picture.part == "Alpha":
        pixels = np.repeat(pixels[..., 3:], 3, axis=2) if image.channels == 4 else np.ones((1, 1, 3), np.float32)
    else:
        pixels = np.repeat(pixels[..., :1], 3, axis=2) if image.channels < 3 else pixels[..., :3]
        if not image.is_float and image.colorspace_settings.name == "sRGB":
            pixels = np.where(pixels <= 0.04045, pixels / 12.92, ((pixels + 0.055) / 1.055) ** 2.4).astype(np.float32)
    for axis in (0, 1):
        step = -(-pixels.shape[axis] // largest)
        starts = np.arange(0, pixels.shape[axis], step)
        counts = np.diff(np.append(starts, pixels.shape[axis])).reshape([-1 if k == axis else 1 for k in range(3)])
        pixels = np.add.reduceat(pixels, starts, axis=axis) / counts.astype(np.float32)
    return 1.0 - pixels if picture.inverted else pixels


def node_color(socket):
    """The constant color (3,) of a socket; one of our own layers counts as the color it replaced, the socket's own."""
    if not socket.is_linked or _is_layer(socket):
        value = socket.default_value
        return np.array(value[:3] if hasattr(value, "__len__") else [value] * 3, float)
    node = socket.links[0].from_node
    if node.type == "RGB":
        return np.array(node.outputs[0].default_value[:3], float)
    if node.type == "VALUE":
        return np.full(3, node.outputs[0].default_value)
    if node.type == "REROUTE":
        return node_color(node.inputs[0])
    raise NotConstant(node.bl_label)


def node_value(socket):
    """The constant value of a socket."""
    if not socket.is_linked:
        return float(socket.default_value)
    node = socket.links[0].from_node
    if node.type == "VALUE":
        return float(node.outputs[0].default_value)
    if node.type == "REROUTE":
        return node_value(node.inputs[0])
    raise NotConstant(node.bl_label)
