"""Objects and meshes of the file, found without a search: Blender looks through all that there are for every name."""

from __future__ import annotations

from time import perf_counter

import bpy


class Lookup:
    """What is in a scene, for one of Blender's turns: after the next anybody may have removed or renamed it.

    Whoever adds to the scene, or removes from it, within the turn says so (`add`, `drop`).
    """

    def __init__(self, scene):
        self.scene, self._begun = scene, perf_counter()
        self._objects = {o.session_uid: o for o in scene.objects}
        self._names = {o.name: o for o in scene.objects if o.library is None}
        self._meshes = None

    def over(self, step):
        """Whether the turn has lasted `step` seconds."""
        return perf_counter() - self._begun > step

    def target(self, target):
        """The object of a read_scene.Target, whatever it is called by now; None if it is no longer in the scene."""
        return self._objects.get(target.uid)

    def own(self, name):
        """The object of a name that is the file's own, whatever is linked under the same name; None if there is none."""
        return self._names.get(name)

    def mesh(self, name):
        """The file's own mesh of a name, as it was called when a mesh was first asked for in the turn, or None."""
        if self._meshes is None:
            self._meshes = {m.name: m for m in bpy.data.meshes if m.library is None}
        return self._meshes.get(name)

    def add(self, object):
        """Find an object of the file's own that was put into the scene, too."""
        self._objects[object.session_uid] = self._names[object.name] = object

    def drop(self, objects):
        """Find objects no more: they are about to be removed."""
        for object in objects:
            del self._objects[object.session_uid], self._names[object.name]
