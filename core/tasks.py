"""The tasks that cells know, by name: pure functions of the kernel and their own small arguments."""

from time import sleep

import numpy as np

from .anew import first_light
from .contacts import find_contacts
from .control import control_points
from .gather import find_sides, gather_points
from .lightmap import light_parts, settle_points
from .occlusion import openness_of_points
from .placing import find_blocked, find_met, find_reach
from .replicates import light_of_block
from .rows import analytic_rows, guide_rows, light_patches, trace_rows


def wait(kernel, seconds, sizes, carried=()):
    """Arrays of `sizes` (K,) zeros each, after some seconds, whatever is carried there: to measure messages, and to
    stand in for other tasks."""
    sleep(seconds)
    return {str(k): np.zeros(size) for k, size in enumerate(sizes)}


def cast(kernel, position, normal, direction, shading=False):
    """{"triangle": (K,) int32, "back": (K,) bool, "distance": (K,) float32 in scene diagonals}: what rays from just above
    places on surfaces (K, 3) meet; shading: of what casts shadows."""
    caster = kernel.caster
    triangle, _, _, distance, back = caster.hits(
        caster.start(position, normal), direction.astype(np.float32), shading=shading
    )
    return {"triangle": triangle, "back": back, "distance": distance}


TASKS = {
    "cast": cast,
    "lit": first_light,
    "contacts": find_contacts,
    "blocked": find_blocked,
    "reach": find_reach,
    "met": find_met,
    "direct": light_patches,
    "rows": trace_rows,
    "guided": guide_rows,
    "analytic": analytic_rows,
    "gather": gather_points,
    "sides": find_sides,
    "settle": settle_points,
    "parts": light_parts,
    "openness": openness_of_points,
    "control": control_points,
    "smooth": light_of_block,
    "wait": wait,
}
