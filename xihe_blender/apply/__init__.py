"""Estimated light in Blender: worlds of spherical harmonics, suns and pictures, on the timeline; and a live session."""
