"""AR lighting previsualisation in Blender: everything that knows Blender. The science is in `xihenet`."""
