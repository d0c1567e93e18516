"""Fixtures that all tests share."""

from __future__ import annotations

import atexit
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from cell_radiosity.core.cells import make_cells

import real_blender

EXIT = pytest.StashKey()  # the exit code of the tests


def pytest_configure():
    """Ctrl-C ends the programs that tests start, also where a shell has started the tests in the background, deaf to it."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session, exitstatus):
    """What `pytest_unconfigure` ends with."""
    session.config.stash[EXIT] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    """End as the command does: Blender's module can wait for a thread of its own for ever, after exports above all."""
    if "bpy" in sys.modules and EXIT in config.stash:
        atexit._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(config.stash[EXIT])


@pytest.fixture(scope="session")
def cells():
    """Two warm cells, processes as in a real bake."""
    with make_cells(2) as made:
        assert not made.note
        yield made


@pytest.fixture
def rng():
    return np.random.default_rng(20261124)


@pytest.fixture(scope="session")
def folder():
    """A folder that a real Blender sees, with sample scenes in it."""
    made = Path(tempfile.mkdtemp(prefix="radiosity-"))
    shutil.copy(real_blender.ROOT / "sample_scenes" / "cornell_box.blend", made / "box.blend")
    shutil.copy(real_blender.ROOT / "sample_scenes" / "hall.blend", made / "hall.blend")
    yield made
    shutil.rmtree(made)


@pytest.fixture(scope="session")
def blender(folder):
    """The real Blender named in the environment, with the built zip."""
    if not real_blender.PROGRAM:
        pytest.skip("BLENDER names no program")
    return real_blender.RealBlender(folder)


@pytest.fixture(scope="session")
def expected(folder, blender):
    """{object.layer: values} of the Cornell box, baked by `radiosity bake` of this Python."""
    out = folder / "module.blend"
    subprocess.run(
        [sys.executable, "-m", "cell_radiosity", "bake", folder / "box.blend", "-o", out, "--quiet"], check=True
    )
    found = blender.layers(out)
    assert {"room.Radiosity", "room.Lighting"} <= set(found)
    return found
