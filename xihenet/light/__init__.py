"""Light that is made of an estimate, for those who light with more than spherical harmonics."""

from typing import Literal

LightParts = Literal["sh", "sh+key", "sh+key+reflections"]
"""What an object is lit with: all of its light as spherical harmonics, its key light apart, and reflections besides."""

LightChoice = Literal["auto", "sh", "sh+key", "sh+key+reflections"]
"""What a user asks for; "auto" takes what the objects call for."""

BetweenEstimates = Literal["carried", "kept"]
"""What becomes of the light in use between estimates, see `xihenet.light.carried_light`."""
