"""Files that are written whole or not at all."""

from __future__ import annotations

import os
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
