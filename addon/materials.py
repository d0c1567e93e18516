"""Blender's materials and world as what the core knows: total reflectance, translucency and exitance.

Owns the reading of shader graphs whose values are constant. Others are left to `cycles_read`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.scene import Material

GLOSS_SHARE = 0.25  # gloss is named when it is more than this share of what a surface reflects
METAL = 0.95  # a metal's reflectance as a share of its base color, after the losses of a rough microfacet surface
LAYER_NAMES = ("Radiosity", "Lighting", "Direct", "Indirect", "Occlusion", "RadiosityError")


class NotConstant(Exception):
    """A value varies over the surface, or comes from a node that is not known here."""


@dataclass(frozen=True)
class _Surface:
    """Shares of the light: reflected diffusely, mirror-like, sent through diffusely, let pass; and radiance emitted."""

    diffuse: np.ndarray
    gloss: np.ndarray
    through: np.ndarray
    emission: np.ndarray

    def __add__(self, other):
        return _Surface(*(getattr(self, n) + getattr(other, n) for n in FIELDS))

    def __mul__(self, share):
        return _Surface(*(getattr(self, n) * share for n in FIELDS))


FIELDS = ("diffuse", "gloss", "through", "emission")


def _surface(**parts):
    return _Surface(*(np.asarray(parts.get(n, np.zeros(3)), float) for n in FIELDS))


def read_material(material, object, ignored):
    """The core's Material of a Blender material (None: Blender's default, diffuse 0.8).

    object: name of an object that uses it, for `ignored`. Raises NotConstant if its graph must be baked to be known.
    """
    if material is None:
        return Material()
    output = material.node_tree.get_output_node("CYCLES") if material.use_nodes and material.node_tree else None
    if output is None:
        return Material(material.name, tuple(np.clip(material.diffuse_color[:3], 0, 1)))
    notes = []
    surface = _shader(output.inputs["Surface"], notes)
    if output.inputs["Volume"].is_linked:
        notes.append("its volume is left out")
    if output.inputs["Displacement"].is_linked:
        notes.append("its displacement is left out")
    total = surface.diffuse + surface.gloss
    if surface.gloss.sum() > GLOSS_SHARE * max(total.sum(), 1e-9):
        share = 100 * surface.gloss.sum() / total.sum()
        notes.append(f"gloss, {share:.0f} % of what it reflects, is sent on diffusely")
    ignored.extend((object, f"{material.name}: {note}") for note in notes)
    return Material(material.name, tuple(total), tuple(np.pi * surface.emission), tuple(surface.through))


def read_world(world, ignored):
    """Radiance (3,) of a Blender world of one color; what varies is replaced by the viewport's color and ignored."""
    if world is None:
        return (0.0, 0.0, 0.0)
    output = world.node_tree.get_output_node("CYCLES") if world.use_nodes and world.node_tree else None
    if output is None:
        return tuple(world.color) if not world.use_nodes else (0.0, 0.0, 0.0)
    try:
        links = output.inputs["Surface"].links
        return tuple(_background(links[0].from_node)) if links else (0.0, 0.0, 0.0)
    except NotConstant as problem:
        ignored.append((world.name, f"the world varies ({problem}): its viewport color lights the scene evenly"))
        return tuple(world.color)


def _background(node):
    if node.type == "BACKGROUND":
        return np.maximum(_color(node.inputs["Color"]) * _value(node.inputs["Strength"]), 0.0)
    raise NotConstant(node.bl_label)


def _shader(socket, notes):
    """The _Surface of a shader socket."""
    if not socket.is_linked:
        return _surface()
    node = socket.links[0].from_node
    if node.type not in SHADERS:
        raise NotConstant(node.bl_label)
    return SHADERS[node.type](node, notes)


def _principled(node, notes):
    get = {s.name: s for s in node.inputs}
    base = np.clip(_color(get["Base Color"]), 0.0, 1.0)
    metal, clear = _value(get["Metallic"]), _value(get["Transmission Weight"])
    for name, word in (("Subsurface Weight", "subsurface light"), ("Coat Weight", "a coat"), ("Sheen Weight", "sheen")):
        if name in get and _value(get[name]) > 0:
            notes.append(f"{word} is left out")
    mirror = _mirror(get)
    opaque = (1.0 - metal) * (1.0 - clear)
    surface = _surface(
        diffuse=base * (1.0 - mirror) * opaque,
        gloss=mirror * (1.0 - metal) + METAL * base * metal + base * (1.0 - mirror) * (1.0 - metal) * clear,
        emission=np.maximum(_emitted(get["Emission Color"], get["Emission Strength"]), 0.0),
    )
    if clear > 0:
        notes.append("refraction: light that would pass is sent back")
    if _value(get["Alpha"]) < 1:
        notes.append("transparency: it is taken as opaque")
    return surface


def _mirror(get):
    """Share of light that a dielectric coat reflects: Fresnel's at right angles, less where it is rough (measured)."""
    ior, rough = _value(get["IOR"]), np.clip(_value(get["Roughness"]), 0.0, 1.0)
    level = _value(get["Specular IOR Level"]) if "Specular IOR Level" in get else 0.5
    tint = np.clip(_color(get["Specular Tint"]), 0.0, 1.0) if "Specular Tint" in get else np.ones(3)
    fresnel = ((ior - 1.0) / (ior + 1.0)) ** 2 * 2.0 * level
    return np.clip(fresnel * (1.0 - 0.65 * rough**3.5) * tint, 0.0, 1.0)


def _diffuse(node, notes):
    return _surface(diffuse=np.clip(_color(node.inputs["Color"]), 0.0, None))


def _glossy(node, notes):
    return _surface(gloss=METAL * np.clip(_color(node.inputs["Color"]), 0.0, None))


def _glass(node, notes):
    notes.append("refraction: light that would pass is sent back")
    return _surface(gloss=np.clip(_color(node.inputs["Color"]), 0.0, 1.0))


def _translucent(node, notes):
    return _surface(through=np.clip(_color(node.inputs["Color"]), 0.0, None))


def _emission(node, notes):
    return _surface(emission=np.maximum(_emitted(node.inputs["Color"], node.inputs["Strength"]), 0.0))


def _mix(node, notes):
    share = np.clip(_value(node.inputs[0]), 0.0, 1.0)
    return _shader(node.inputs[1], notes) * (1.0 - share) + _shader(node.inputs[2], notes) * share


def _add(node, notes):
    return _shader(node.inputs[0], notes) + _shader(node.inputs[1], notes)


def _transparent(node, notes):
    notes.append("transparency: it is taken as opaque")
    return _surface()


def _reroute(node, notes):
    return _shader(node.inputs[0], notes)


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
    return _color(color) * _value(strength)


def _is_layer(socket):
    """Whether a socket is fed by one of our own layers."""
    while socket.is_linked and socket.links[0].from_node.type == "REROUTE":
        socket = socket.links[0].from_node.inputs[0]
    if not socket.is_linked:
        return False
    node = socket.links[0].from_node
    name = getattr(node, "layer_name", None) or getattr(node, "attribute_name", "")
    return node.type in {"VERTEX_COLOR", "ATTRIBUTE"} and name.split("_")[0] in LAYER_NAMES


def _color(socket):
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
        return _color(node.inputs[0])
    raise NotConstant(node.bl_label)


def _value(socket):
    """The constant value of a socket."""
    if not socket.is_linked:
        return float(socket.default_value)
    node = socket.links[0].from_node
    if node.type == "VALUE":
        return float(node.outputs[0].default_value)
    if node.type == "REROUTE":
        return _value(node.inputs[0])
    raise NotConstant(node.bl_label)
