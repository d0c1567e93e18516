"""Cell Radiosity: bakes interreflected light into Blender meshes.

The folder of this file is the package, as a Blender extension and when installed with pip. Nothing that needs Blender
is imported here: the core runs without it.
"""


def register():
    """Called by Blender when the extension is enabled."""
    from . import addon

    addon.register()


def unregister():
    """Called by Blender when the extension is disabled."""
    from . import addon

    addon.unregister()
