"""All that knows Blender: reading scenes, writing results, the panel and the command line."""
