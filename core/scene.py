"""The scene as plain arrays: what every later step reads and none of them changes.

Owns the records `Material`, `Lamp`, `World`, `Mesh` and `Scene`, the joining of meshes into one scene, and the few
geometric facts (triangle normals and areas, extent) that everything else needs. World space, float64, meters;
light in W/m^2 (exitance), W/sr (intensity) and W/(m^2 sr) (radiance), linear RGB on the last axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .vectors import by_coordinate, changes, counted, cross, dot, length, rows_of, runs, take, unit, whole_runs

BLACK = (0.0, 0.0, 0.0)
OUTERMOST = 0.03  # of the vertices, on every side, lie outside of what a bake is about
# What a scene's shape depends on, and what is found of it once and kept.
GEOMETRY = {"vertices", "polygon_start", "corner_vertex", "triangle_corner", "triangle_polygon"}
KNOWN = ("polygon_normal", "triangles", "triangle_normal_area", "solid", "bounds", "diagonal")
FLAT = 0.9995  # least cosine between the triangles of one flat facet
LEAST_AREA = 1e-200  # [m^2]; of less, float64 cannot tell the middle


@dataclass(frozen=True)
class Material:
    """What a surface does with light, the same on both of its sides.

    reflectance, translucency: (3,) share of the irradiance sent back and sent through, diffusely [-].
    exitance: (3,) emitted light, leaving both sides [W/m^2]; Blender's emission strength times pi.
    texture: number of a texture of the scene, tint: (3,); the texture times the tint is added to the reflectance.
    alpha: share of the surface that is there, times that of alpha_texture, the number of a texture whose first channel is
    meant, if there is one. Rays pass the rest; reflectance, exitance and translucency are those of what is there.
    """

    name: str = "default"
    reflectance: tuple = (0.8, 0.8, 0.8)
    exitance: tuple = BLACK
    translucency: tuple = BLACK
    texture: int | None = None
    tint: tuple = (1.0, 1.0, 1.0)
    alpha: float = 1.0
    alpha_texture: int | None = None

    @property
    def transparent(self):
        """Whether rays may pass it."""
        return self.alpha < 1.0 or self.alpha_texture is not None


@dataclass(frozen=True)
class Lamp:
    """A light that is no surface: it never blocks a ray.

    kind: "point", "spot", "sun" or "area".
    strength: (3,) what the kind radiates: intensity of a point or spot [W/sr], irradiance of a facing surface under
        a sun [W/m^2], radiance of an area lamp [W/(m^2 sr)].
    position: (3,) meters. axes: (3, 3) rows are the lamp's own x, y and z axes as unit vectors; it shines along -z.
    radius: of a point or spot [m]. soft: Blender's soft falloff (the sphere is a disk that faces the receiver).
    angle: full angle of a sun's disk or of a spot's cone [rad]. blend: soft part of a spot's cone [0..1].
    size: (2,) of an area lamp along its x and y axes [m]. ellipse: an area lamp is an ellipse, not a rectangle.
    spread: full angle that an area lamp shines into [rad]: its radiance falls with the tangent of the angle to its axis,
        to 0 at half of this, at the same power; pi: it is the same in all directions.
    shadows: whether it casts any; without them, its light goes through everything.
    """

    kind: str
    strength: tuple
    position: tuple = (0.0, 0.0, 0.0)
    axes: tuple = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    name: str = "lamp"
    radius: float = 0.0
    soft: bool = True
    angle: float = 0.0
    blend: float = 0.0
    size: tuple = (1.0, 1.0)
    ellipse: bool = False
    spread: float = float(np.pi)
    shadows: bool = True


@dataclass(frozen=True)
class World:
    """Light from outside the scene. radiance: (3,) of every direction [W/(m^2 sr)]; map: (K, K, 3) instead, of the cells of
    an octahedral map (see `sky`), or None."""

    radiance: tuple = BLACK
    map: np.ndarray | None = None

    @property
    def brightest(self):
        """The largest radiance in any direction and channel."""
        return float(max(self.radiance) if self.map is None else np.nan_to_num(self.map).max(initial=0.0))


@dataclass(frozen=True)
class Mesh:
    """One object as it is rendered, in world space.

    vertices: (V, 3) float64. polygon_start: (P + 1,) int, polygon p owns corners polygon_start[p] to
    polygon_start[p + 1]. corner_vertex: (C,) int. corner_normal: (C, 3) shading normals, None for flat shading.
    triangle_corner: (T, 3) int corners of the triangles that fill the polygons, None for a fan of each polygon
    (right for convex polygons). triangle_polygon: (T,) int. polygon_material: (P,) int into the scene's materials.
    corner_uv: (C, 2) place in the texture of each corner's material, None if there is none.
    """

    name: str
    vertices: np.ndarray
    polygon_start: np.ndarray
    corner_vertex: np.ndarray
    polygon_material: np.ndarray
    corner_normal: np.ndarray | None = None
    triangle_corner: np.ndarray | None = None
    triangle_polygon: np.ndarray | None = None
    corner_uv: np.ndarray | None = None

    @classmethod
    def of_polygons(cls, name, vertices, polygons, material=0, **fields):
        """A mesh of a list of polygons, each a list of vertex indices."""
        sizes = [len(p) for p in polygons]
        return cls(
            name,
            np.asarray(vertices, float).reshape(-1, 3),
            np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32),
            np.concatenate(polygons).astype(np.int32) if polygons else np.zeros(0, np.int32),
            np.broadcast_to(np.asarray(material, np.int32), len(polygons)).copy(),
            **fields,
        )


@dataclass(frozen=True)
class Scene:
    """All meshes joined into one set of arrays, with materials, lamps and world.

    objects: (O,) names. The arrays are `Mesh`'s, one object after the other, indices counted through the whole scene;
    polygon_object: (P,) int. corner_normal is always given here. written: (O,) bool, objects whose light is asked for.
    textures: tuple of surfaces.Texture; corner_uv: (C, 2) where each corner lies in its material's texture.
    readings: a surfaces.Readings of colors that replace those of the materials.
    shared: (O,) int number of the mesh that each object is a copy of; None: each has its own.
    shading: (O,) bool, objects that cast shadows; light straight from lamps, faces and sky goes through the others, which rays
    for reflected light meet all the same. None: all do.
    health: findings, and ignored: (object, reason) pairs, of whoever read the scene.
    left_out: (P,) bool, polygons with broken vertices, and double: (P,) bool, polygons that lie on others and take no
    part, as found by health.mend; mended: it has been there.
    """

    objects: tuple
    vertices: np.ndarray
    polygon_start: np.ndarray
    polygon_object: np.ndarray
    polygon_material: np.ndarray
    corner_vertex: np.ndarray
    corner_normal: np.ndarray
    triangle_corner: np.ndarray
    triangle_polygon: np.ndarray
    materials: tuple = (Material(),)
    lamps: tuple = ()
    world: World = World()
    written: np.ndarray | None = None
    textures: tuple = ()
    corner_uv: np.ndarray | None = None
    readings: object | None = None
    shared: np.ndarray | None = None
    shading: np.ndarray | None = None
    health: tuple = ()
    ignored: tuple = ()
    name: str = "scene"
    left_out: np.ndarray | None = None
    double: np.ndarray | None = None
    mended: bool = False

    def __post_init__(self):
        for name in ("left_out", "double"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.zeros(len(self.polygon_object), bool))

    def but(self, **changes):
        """The scene with some fields changed. What is known of its geometry stays known, unless that changes."""
        other = replace(self, **changes)
        if not GEOMETRY & changes.keys():
            other.__dict__.update((name, self.__dict__[name]) for name in KNOWN if name in self.__dict__)
        return other

    @cached_property
    def polygon_normal(self):
        """(P, 3) unit normals of the polygons; 0 where one has no area."""
        return newell_normals(self.vertices, self.polygon_start, self.corner_vertex)

    @cached_property
    def triangles(self):
        """(T, 3) int32 vertex indices of the triangles."""
        return self.corner_vertex[self.triangle_corner].astype(np.int32)

    @cached_property
    def triangle_normal_area(self):
        """Unit normals (T, 3) and areas (T,) of the triangles; a degenerate triangle has area 0 and normal 0."""
        count = len(self.triangles)
        normal, area = np.empty((count, 3)), np.empty(count)
        for part in runs(count):
            normal[part], area[part] = normal_and_area(*self.corners_of(part))
        return normal, area

    def corners_of(self, triangles):
        """Corners a, b, c, (K, 3) each, of triangles (K,) or a slice of them [m], stored by coordinate."""
        corner = self.triangles[triangles] if isinstance(triangles, slice) else rows_of(self.triangles, triangles)
        return tuple(by_coordinate(rows_of(self.vertices, column)) for column in corner.T)

    @cached_property
    def solid(self):
        """(T,) bool: triangles with finite vertices and an area."""
        finite = np.isfinite(self.vertices).all(axis=1)[self.triangles].all(axis=1)
        with np.errstate(invalid="ignore", over="ignore"):
            return finite & (self.triangle_normal_area[1] > LEAST_AREA)

    def used_vertices(self, triangles):
        """(K,) the vertices of triangles, by their numbers or a (T,) bool, in order."""
        used = np.zeros(len(self.vertices), bool)
        for column in range(3):
            used[self.triangles[triangles, column]] = True
        return np.flatnonzero(used)

    @cached_property
    def usable(self):
        """(T,) bool: the triangles that take part, solid ones of polygons that do not lie on others."""
        return self.solid & ~self.double[self.triangle_polygon]

    @cached_property
    def facets(self):
        """The flat parts of polygons: usable triangles (K,) in order of facet, and the facet (K,) of each, 0, 1, ... A planar
        polygon is one facet; a warped one is a facet per triangle."""
        triangle = np.flatnonzero(self.usable)
        polygon = self.triangle_polygon[triangle]
        bent = np.zeros(len(self.polygon_material), bool)
        for part in runs(len(triangle)):
            whole = rows_of(self.polygon_normal, polygon[part])
            own = rows_of(self.triangle_normal_area[0], triangle[part])
            bent[polygon[part][dot(own, whole) < FLAT]] = True
        key = np.where(bent[polygon], len(bent) + np.arange(len(triangle)), polygon)
        order = np.argsort(key, kind="stable")
        return triangle[order], np.cumsum(changes(key[order])) - 1

    @cached_property
    def facet_boxes(self):
        """Lowest and highest corners (F, 3) of the facets."""
        triangle, facet = self.facets
        start = np.append(np.flatnonzero(changes(facet)), len(triangle))
        low, high = np.empty((2, len(start) - 1, 3))
        for part in whole_runs(start):
            begin = start[part.start]
            corners = self.corners_of(triangle[begin : start[part.stop]])
            low[part], high[part] = box_of(corners, start[part] - begin)
        return low, high

    @cached_property
    def bounds(self):
        """Lowest and highest corner of the solid geometry, (2, 3); zeros if there is none."""
        used = self.vertices[self.used_vertices(self.solid)]
        return np.stack([used.min(axis=0), used.max(axis=0)]) if len(used) else np.zeros((2, 3))

    @cached_property
    def focus_bounds(self):
        """Lowest and highest corner (2, 3) of what a bake is about: of the written objects' vertices but for the outermost
        3 % on every side. A wide ground with few vertices does not count, a fine one does."""
        mine = self.usable & self.written[self.polygon_object[self.triangle_polygon]]
        used = self.vertices[self.used_vertices(mine if mine.any() else self.usable)]
        if not len(used):
            return np.zeros((2, 3))
        cut = int(OUTERMOST * len(used))
        ends = [cut, len(used) - 1 - cut]
        return np.partition(used, ends, axis=0)[ends]

    @cached_property
    def focus(self):
        """How large that is: the diagonal of its box [m]."""
        low, high = self.focus_bounds
        return float(np.sqrt(((high - low) ** 2).sum())) or self.diagonal

    @cached_property
    def diagonal(self):
        """Length of the bounding box's diagonal [m]."""
        low, high = self.bounds
        return float(np.sqrt(((high - low) ** 2).sum()))


def box_of(corners, start):
    """Lowest and highest coordinates (F, D) of triangles' corners a, b, c, (K, D) each, over runs that begin at start (F,)."""
    a, b, c = corners
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    return np.minimum.reduceat(low, start), np.maximum.reduceat(high, start)


def normal_and_area(a, b, c):
    """Unit normals (..., 3) and areas (...) of triangles with corners a, b, c; normal 0 where the area is 0."""
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        n = cross(b - a, c - a)
        return unit(n), length(n) / 2


def fan_triangles(polygon_start):
    """Triangles that fill convex polygons: corners (T, 3) and polygon (T,), each polygon as a fan from its first corner."""
    polygon, step = counted(np.maximum(np.diff(polygon_start) - 2, 0))
    first = polygon_start[:-1][polygon]
    return np.stack([first, first + step + 1, first + step + 2], axis=1), polygon


def join_meshes(meshes, materials=(Material(),), lamps=(), world=World(), written=None, name="scene", **notes):
    """One scene of many meshes. written: (O,) bool, objects whose light is asked for (None: all); notes: see Scene.

    Raises ValueError naming the mesh whose material index is outside `materials`.
    """
    meshes = tuple(meshes)
    vertex0 = corner0 = polygon0 = 0
    parts = {k: [] for k in ("v", "ps", "po", "pm", "cv", "cn", "uv", "tc", "tp")}
    for index, mesh in enumerate(meshes):
        material = np.asarray(mesh.polygon_material, np.int32)
        if len(material) and not (material.min() >= 0 and material.max() < len(materials)):
            raise ValueError(f"{mesh.name}: material index {material.max()} of {len(materials)} materials")
        corners, polygons = mesh.triangle_corner, mesh.triangle_polygon
        if corners is None:
            corners, polygons = fan_triangles(mesh.polygon_start)
        parts["v"].append(np.asarray(mesh.vertices, float))
        parts["ps"].append(np.asarray(mesh.polygon_start[:-1]) + corner0)
        parts["po"].append(np.full(len(material), index, np.int32))
        parts["pm"].append(material)
        parts["cv"].append(np.asarray(mesh.corner_vertex) + vertex0)
        parts["cn"].append(flat_normals(mesh) if mesh.corner_normal is None else np.asarray(mesh.corner_normal, float))
        parts["uv"].append(np.zeros((len(mesh.corner_vertex), 2)) if mesh.corner_uv is None else mesh.corner_uv)
        parts["tc"].append(np.asarray(corners).reshape(-1, 3) + corner0)
        parts["tp"].append(np.asarray(polygons) + polygon0)
        vertex0 += len(mesh.vertices)
        corner0 += len(mesh.corner_vertex)
        polygon0 += len(material)

    def joined(key, dtype, shape=(0,)):
        return np.concatenate(parts[key]).astype(dtype) if parts[key] else np.zeros(shape, dtype)

    return Scene(
        objects=tuple(m.name for m in meshes),
        vertices=joined("v", float, (0, 3)),
        polygon_start=np.append(joined("ps", np.int32), corner0).astype(np.int32),
        polygon_object=joined("po", np.int32),
        polygon_material=joined("pm", np.int32),
        corner_vertex=joined("cv", np.int32),
        corner_normal=joined("cn", float, (0, 3)),
        corner_uv=joined("uv", float, (0, 2)) if any(m.corner_uv is not None for m in meshes) else None,
        triangle_corner=joined("tc", np.int32, (0, 3)),
        triangle_polygon=joined("tp", np.int32),
        materials=tuple(materials),
        lamps=tuple(lamps),
        world=world,
        written=np.ones(len(meshes), bool) if written is None else np.asarray(written, bool),
        name=name,
        **notes,
    )


def following_corners(polygon_start):
    """(C,) int32 the corner that follows each corner in its polygon."""
    following = np.arange(1, polygon_start[-1] + 1, dtype=np.int32)
    full = polygon_start[1:] > polygon_start[:-1]
    following[polygon_start[1:][full] - 1] = polygon_start[:-1][full]
    return following


def flat_normals(mesh):
    """(C, 3) normal of its own polygon at every corner (Newell's sum over the polygon's edges)."""
    normal = newell_normals(mesh.vertices, mesh.polygon_start, mesh.corner_vertex)
    return np.repeat(normal, np.diff(mesh.polygon_start), axis=0)


def newell_normals(vertices, polygon_start, corner_vertex):
    """(P, 3) unit normals of polygons of any shape; 0 where a polygon has no area."""
    normal = np.zeros((len(polygon_start) - 1, 3))
    for part in whole_runs(polygon_start):
        start = polygon_start[part.start : part.stop + 1]
        normal[part] = _newell_normals(vertices, start - start[0], corner_vertex[start[0] : start[-1]])
    return normal


def _newell_normals(vertices, polygon_start, corner_vertex):
    size = np.diff(polygon_start)
    corner = np.arange(len(corner_vertex))
    polygon = np.repeat(np.arange(len(size)), size)
    last = corner == polygon_start[1:][polygon] - 1
    following = np.where(last, polygon_start[:-1][polygon], corner + 1)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        place = by_coordinate(rows_of(vertices, corner_vertex))
        origin = take(place, polygon_start[polygon])
        edge = cross(place - origin, take(place, following) - origin)
        return unit(np.stack([np.bincount(polygon, edge[:, k], len(size)) for k in range(3)], axis=1))
