"""Start of a cell's process: loads the core under a name of its own, without Blender, and serves `pipe`.

Run by `runpy.run_path` with `pipe` among its globals. Threads are held to one before numpy is imported: there is a
cell per core already.
"""

import contextlib
import ctypes
import importlib.util
import os
import sys

for library in ("OMP", "OPENBLAS", "MKL", "VECLIB", "NUMEXPR", "TBB"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

# Of the arrays of one task most are as large as those of the next; where the GNU library gives their memory back in between,
# the system clears it again and again: 5000 pages in a small bake, 2 to 10 % of its time. (Elsewhere there is no mallopt.)
TRIM, MAP = -1, -3  # M_TRIM_THRESHOLD, M_MMAP_THRESHOLD
with contextlib.suppress(AttributeError, OSError, TypeError):
    for option, size in ((TRIM, 1 << 25), (MAP, 1 << 23)):
        ctypes.CDLL(None).mallopt(option, size)

here = os.path.dirname(os.path.abspath(__file__))
spec = importlib.util.spec_from_file_location(
    "radiosity_core", os.path.join(here, "__init__.py"), submodule_search_locations=[here]
)
sys.modules["radiosity_core"] = package = importlib.util.module_from_spec(spec)
spec.loader.exec_module(package)

from radiosity_core.cell import serve  # noqa: E402

serve(pipe)  # noqa: F821
