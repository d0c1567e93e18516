"""What vertices buy, on meshes fitted to the light and on even ones: python -m tools.bench.vertices.

Prints for the sunlit room how many vertices a mesh has, and how far the light that is shown, linear between the vertices,
is off at random places of its surface (root mean square over that of the light). The light at the vertices and that at
the places come from two bakes, whose own errors (--error) are in every figure: only differences above them tell of the mesh.
"""

from __future__ import annotations

import argparse

import numpy as np

from cell_radiosity.addon.job import default_cells
from cell_radiosity.core.bake import bake, run
from cell_radiosity.core.cells import make_cells
from cell_radiosity.core.points import Points
from cell_radiosity.core.sampling import morton_order
from cell_radiosity.core.settings import Settings
from cell_radiosity.core.subdivide import Fitting, fit_mesh

from .scenes import opened


def fitted(scene, fitting, settings, cells):
    """The finer scene that a fitting makes of one, and the light (C, corners) at its corners."""

    def place(scene, flipped, cells, light, kept):
        finer, points, _ = yield from fit_mesh(scene, fitting, flipped, cells, light)
        return finer, points, {}

    baked = run(bake(scene, settings, cells, place))
    total = baked.light.total
    light = np.zeros((len(total), len(baked.scene.corner_vertex)))
    light[:, baked.points.corner] = total[:, baked.points.corner_point]
    return baked.scene, light


def light_at(scene, finer, triangle, weight, settings, cells):
    """(C, K) light of a scene at places on triangles (K,) of a finer mesh of it, by the weights (K, 3) of their corners."""
    position = np.einsum("kv,kvd->kd", weight, finer.vertices[finer.triangles[triangle]])
    order = morton_order(position)

    def place(scene, flipped, cells, light, kept):
        normal, area = (x[triangle[order]] for x in finer.triangle_normal_area)
        none, count = np.zeros(0, np.int32), len(order)
        points = Points(
            position=position[order],
            normal=normal,
            geometric=normal,
            area=np.full(count, area.sum() / count),
            object=finer.polygon_object[finer.triangle_polygon[triangle[order]]],
            smooth=np.ones(count, bool),
            neighbor_start=np.zeros(count + 1, np.int32),
            neighbor=none,
            corner=none,
            corner_point=none,
            thin=np.zeros(count, bool),
        )
        return scene, points, {}
        yield

    total = run(bake(scene, settings, cells, place)).light.total
    light = np.empty_like(total)
    light[:, order] = total
    return light


def error_of(scene, finer, light, places, settings, cells):
    """Vertices that a mesh has, and how far its light is off at random places."""
    rng = np.random.default_rng(0)
    mine = np.flatnonzero(finer.written[finer.polygon_object[finer.triangle_polygon]])
    upto = np.cumsum(finer.triangle_normal_area[1][mine])
    triangle = mine[np.minimum(np.searchsorted(upto, rng.random(places) * upto[-1]), len(mine) - 1)]
    weight = rng.dirichlet((1, 1, 1), places)
    true = light_at(scene, finer, triangle, weight, settings, cells)
    shown = np.einsum("kv,ckv->ck", weight, light[:, finer.triangle_corner[triangle]])
    return len(np.unique(finer.triangles[mine])), np.sqrt(((shown - true) ** 2).sum() / (true**2).sum())


def main():
    """Read the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--scene", default="sunlit_room")
    parser.add_argument("--places", type=int, default=6000)
    parser.add_argument("--error", type=float, default=0.5, help="percent, of the bakes (default: 0.5)")
    parser.add_argument("--fitted", default="1,2", help="vertices come within so many times the usual longest edge")
    parser.add_argument("--even", default=".25,.15", help="edges of even meshes, in usual longest edges")
    arguments = parser.parse_args()
    scene, settings = opened(arguments.scene), Settings.for_error(arguments.error / 100)
    usual = Fitting.for_scene(scene).max_edge
    asked = [("fitted", Fitting.for_scene(scene, float(k) * usual)) for k in arguments.fitted.split(",")]
    asked += [("even", Fitting(float(k) * usual, float(k) * usual, passes=0)) for k in arguments.even.split(",")]
    with make_cells(default_cells()) as cells:
        for kind, fitting in asked:
            finer, light = fitted(scene, fitting, settings, cells)
            vertices, error = error_of(scene, finer, light, arguments.places, settings, cells)
            print(
                f"{kind:6} edges up to {fitting.max_edge:.3f} m: {vertices:7} vertices, {100 * error:.2f} %", flush=True
            )


if __name__ == "__main__":
    main()
