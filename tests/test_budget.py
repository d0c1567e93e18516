"""The memory budget: host and cells together keep to it by fewer cells, and no bit changes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cell_radiosity.core.budget import CELL, HOST_POINT, cells_within
from cell_radiosity.core.cells import memory_now, peak_memory

SCRIPT = """
import json, sys
from hashlib import blake2b
from cell_radiosity.core.cells import make_cells
from scenes import Lamp, Settings, bake, box, join_meshes, run

scene = join_meshes([box(n=60), box("block", (0.3, 0.3, 0.0), (0.6, 0.6, 0.5), 20, False)], lamps=[Lamp("point", (1, 1, 1), (0.2, 0.3, 0.8))])
with make_cells(4) as cells:
    found = run(bake(scene, Settings.for_error(0.05, memory=float(sys.argv[1])), cells))
light = blake2b(found.light.total.tobytes()).hexdigest()
print(json.dumps({**found.cells, "light": light, "told": [f.action for f in found.survey.health]}))
"""


def baked(memory):
    """What a bake in a process of its own tells that may use so much memory [MB], with four cells."""
    told = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(1e6 * memory)],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent)}, check=True, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    return json.loads(told.stdout.splitlines()[-1])


def test_more_memory_holds_more_cells():
    now, sizes = 1e6 * memory_now(), dict(triangles=1000, patches=1000, points=1000)
    counts = [cells_within(now + n * CELL, **sizes, begun=True) for n in range(20)]
    assert counts[0] == 0 < counts[-1] < 20
    assert counts == sorted(counts)
    crowded = cells_within(now + 20 * CELL, 1000, 1000, 10 * int(CELL / HOST_POINT), begun=True)
    assert abs(counts[-1] - 10 - crowded) <= 1  # this process grows meanwhile
    assert cells_within(now + 20 * CELL, 1_000_000, 1000, 1000, begun=True) < counts[-1]
    assert cells_within(0.0, **sizes, begun=False) == 0


def test_memory_now_is_not_above_its_peak():
    assert 0 < memory_now() <= peak_memory()


@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="only Linux tells what a process takes now")
def test_host_and_cells_keep_to_the_budget_together():
    """Of four cells as many work as fit, none where there is room for none; the light is the same, and what was not there
    is told."""
    found = {memory: baked(memory) for memory in (2000, 400, 300, 180)}
    assert len({told["light"] for told in found.values()}) == 1
    for memory, told in found.items():
        assert told["host_mb"] + sum(told["cells_mb"]) < memory
    plenty, some, few, none = (len(told["cells_mb"]) for told in found.values())
    assert plenty == 4 > some >= few > none == 0
    assert not found[2000]["told"]
    assert found[400]["told"] == [f"only {some} of 4 cells fit into the memory that may be used"]
    assert "in this process" in found[180]["told"][0]
