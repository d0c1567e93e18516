"""The package's version for setuptools: the extension's manifest is its only source."""

import tomllib
from pathlib import Path

VERSION = tomllib.loads((Path(__file__).parent.parent / "blender_manifest.toml").read_text())["version"]
