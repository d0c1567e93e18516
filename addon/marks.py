"""Marks on what a bake makes, so that the next bake replaces it and never reads it as scene."""

import contextlib

KEY = "cell_radiosity"


def mark(thing):
    """Mark an object or image as made by a bake."""
    thing[KEY] = True


def is_made(thing):
    """Whether a bake made it."""
    return bool(thing.get(KEY, False))


def shown_for(material):
    """The material for which one that a bake made shows light; None for none."""
    return material.get(f"{KEY}_of")


def mark_layers(mesh, names):
    """Note on a mesh which of its attributes bakes have written."""
    mesh[KEY] = "\n".join(sorted(set(names) | made_layers(mesh)))


def made_layers(mesh):
    """Names of a mesh's attributes that bakes have written."""
    text = mesh.get(KEY, "")
    return set(text.split("\n")) - {""} if isinstance(text, str) else set()


def unmark_layers(mesh):
    """Forget which attributes of a mesh bakes have written."""
    if KEY in mesh:
        del mesh[KEY]


def stand_ins(scene):
    """The copies in a scene that hold the results of other objects of it. A copy whose original is gone, or goes by another
    name, or that is linked from another file, is none: it is an object like any other."""
    names = {o.name for o in scene.objects if not o.library}
    return [o for o in scene.objects if is_made(o) and not o.library and o.get(f"{KEY}_of") in names]


def hide(objects, hidden):
    """Hide objects in renders and views, or show them."""
    for object in objects:
        object.hide_render = object.hide_viewport = hidden


@contextlib.contextmanager
def originals_shown(scene):
    """While a scene is read, show the objects that are hidden because a copy holds their result."""
    names = {o[f"{KEY}_of"] for o in stand_ins(scene)}
    hidden = [o for o in scene.objects if o.name in names and o.library is None]
    numbers = {o.session_uid for o in hidden}
    try:
        hide(hidden, False)
        yield
    finally:
        if numbers:  # some of them, or the scene, may be gone by now
            hide([o for o in scene.objects if o.session_uid in numbers], True)
