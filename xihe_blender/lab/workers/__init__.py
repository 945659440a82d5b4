"""Other processes that have Blender: on this machine, or a Dask scheduler's."""
