"""Radiosity on plain arrays: the part of the product that knows nothing of Blender.

Data flows one way, and imports follow it:

    Scene --survey--> Effects --make_patches--> Patches --make_points--> Points
          --solve--> Solution --gather--> Light          (`bake` is this line, as code)

Every arrow is a function of arrays, every value a frozen record. Nothing in this package imports bpy.
"""
