"""Rooms made by the thousand: sampled as data, built in Blender, rendered as a phone and a light probe see them."""
