"""Building blocks of rooms: solids, materials, furniture, lamps, walls; shared by the scenes and the data set."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import bpy

Material: TypeAlias = bpy.types.Material
Collection: TypeAlias = bpy.types.Collection
Vector: TypeAlias = Sequence[float]
