"""The version of this extension: the manifest is its only source."""

import tomllib
from pathlib import Path


def version():
    """Version of this extension, as in its manifest."""
    with open(Path(__file__).parent.parent / "blender_manifest.toml", "rb") as file:
        return tomllib.load(file)["version"]
