"""Estimated light in Blender: worlds of spherical harmonics, and a live session."""
