"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cell_radiosity.core.saving import written_together, written_whole


def contents(folder):
    return {p.name: p.read_text() if p.is_file() else None for p in folder.iterdir()}


def test_what_was_there_stays_until_the_end(tmp_path):
    path = tmp_path / "f.json"
    for text in ("one", "two"):
        with written_whole(path, ".x") as temporary:
            assert temporary.endswith(".x")
            Path(temporary).write_text(text)
            assert path.exists() == (text == "two")
        assert contents(tmp_path) == {"f.json": text}


@pytest.mark.parametrize("written", [written_whole, written_together])
@pytest.mark.parametrize("problem", [KeyboardInterrupt, ValueError, OSError(28, "full")])
def test_what_fails_leaves_nothing(tmp_path, written, problem):
    path = tmp_path / "f"
    path.write_text("before")

    def fail():
        with written(path) as temporary:
            Path(temporary).write_text("half")
            raise problem

    with pytest.raises(problem if isinstance(problem, type) else OSError) as caught:
        fail()
    assert contents(tmp_path) == {"f": "before"}
    if isinstance(problem, OSError):
        assert (caught.value.filename, caught.value.errno) == (path, 28)


def test_a_folder_is_not_written(tmp_path):
    with pytest.raises(IsADirectoryError) as caught, written_whole(tmp_path):
        pass
    assert caught.value.filename == tmp_path
    assert contents(tmp_path) == {}


def test_files_that_come_together(tmp_path):
    (tmp_path / "f.bin").write_text("before")
    (tmp_path / "other").write_text("before")
    with written_together(tmp_path / "f.gltf") as temporary:
        Path(temporary).write_text("new")
        Path(temporary).with_name("f.bin").write_text("new")
    assert contents(tmp_path) == {"f.gltf": "new", "f.bin": "new", "other": "before"}


@pytest.mark.skipif(os.name != "posix", reason="links and devices of Unix")
def test_links_and_devices(tmp_path):
    """A link stays one, and what it leads to is written; a device is written itself."""
    (tmp_path / "link").symlink_to(tmp_path / "there")
    for _ in range(2):  # a link to nothing, and to a file
        with written_whole(tmp_path / "link") as temporary:
            Path(temporary).write_text("new")
        assert (tmp_path / "link").is_symlink()
        assert (tmp_path / "there").read_text() == "new"
    with written_whole(os.devnull) as temporary:
        assert temporary == os.devnull
    assert not os.path.isfile(os.devnull)


KILLED = """
import os, signal, sys
from pathlib import Path
from cell_radiosity.core import saving
with getattr(saving, sys.argv[1])(sys.argv[2], ".x") as temporary:
    Path(temporary).write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(os.name != "posix", reason="signals of Unix")
@pytest.mark.parametrize("written", [written_whole, written_together])
def test_what_a_killed_process_left_goes_with_the_next_write(tmp_path, written):
    """And nothing else: not what is being written, nor what was of late, nor files of others that are called alike."""
    path = tmp_path / "f(1).x"
    done = subprocess.run([sys.executable, "-c", KILLED, written.__name__, path])
    assert done.returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    end = "" if left.is_dir() else ".x"
    gone, alive = left.name.removeprefix("f(1).x.tmp").removesuffix(end), os.getppid()
    names = [
        f"f(1).x.tmp{alive}{end}",
        f"f(1).x.tmp{gone}.y",
        f"f(1).x.tmp{end}",
        f"g(1).x.tmp{gone}{end}",
        f"f(1).x.{gone}",
    ]
    for name in names:
        (tmp_path / name).write_text("kept")

    def write(text):
        with written(path, ".x") as temporary:
            Path(temporary).write_text(text)

    write("one")  # it is too young to be surely left
    assert contents(tmp_path).keys() == {path.name, left.name, *names}
    for each in (*tmp_path.iterdir(), *(left.iterdir() if left.is_dir() else ())):
        os.utime(each, (0, 0))
    write("two")
    assert contents(tmp_path) == {path.name: "two", **dict.fromkeys(names, "kept")}


def test_a_folder_of_the_own_number_is_in_nobodys_way(tmp_path):
    """Numbers of processes come again."""
    left = tmp_path / f"f.tmp{os.getpid()}"
    left.mkdir()
    (left / "half").write_text("half")
    for each in (left / "half", left):
        os.utime(each, (0, 0))
    with written_together(tmp_path / "f") as temporary:
        Path(temporary).write_text("new")
    assert contents(tmp_path) == {"f": "new"}
