"""All that knows Blender: reading scenes, writing results, the panel and the command line."""

import bpy

from . import operators, panels, preferences, properties, result, session, translations, viewport

MODULES = (preferences, result, properties, operators, panels)
CLASSES = tuple(cls for module in MODULES for cls in module.CLASSES)

_commands = []


def register():
    """Register words, classes, settings, handlers and the `radiosity` command."""
    from .command import main

    translations.register()
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    properties.attach()
    session.register()
    viewport.register()
    if hasattr(bpy.utils, "register_cli_command"):
        _commands.append(bpy.utils.register_cli_command("radiosity", main))


def unregister():
    """Undo `register`, in reverse; cells end first."""
    viewport.unregister()
    session.unregister()
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    properties.detach()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
    translations.unregister()
