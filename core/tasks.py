"""The tasks that cells know, by name: pure functions of the kernel and their own small arguments."""

from .contacts import find_contacts
from .gather import gather_points
from .rows import analytic_rows, light_patches, trace_rows

TASKS = {
    "contacts": find_contacts,
    "direct": light_patches,
    "rows": trace_rows,
    "analytic": analytic_rows,
    "gather": gather_points,
}
