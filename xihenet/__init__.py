"""Xihe's science: from RGB-D frames to spherical-harmonic light, in NumPy. Never imports Blender."""

__version__ = "0.1.0"
