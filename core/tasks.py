"""The tasks that cells know, by name: pure functions of the kernel and their own small arguments."""

from time import sleep

import numpy as np

from .contacts import find_contacts
from .gather import gather_points
from .rows import analytic_rows, light_patches, trace_rows


def wait(kernel, seconds, sizes):
    """Arrays of `sizes` (K,) zeros each, after some seconds: to measure messages, and to stand in for other tasks."""
    sleep(seconds)
    return {str(k): np.zeros(size) for k, size in enumerate(sizes)}


TASKS = {
    "contacts": find_contacts,
    "direct": light_patches,
    "rows": trace_rows,
    "analytic": analytic_rows,
    "gather": gather_points,
    "wait": wait,
}
