"""Everything of the open file that a user could miss, as one flat table: {"scenes/Scene/render/fps": 24, ...}.

Every data-block is walked by its RNA properties, so that a setting nobody thought of is compared as well.
"""

import contextlib
import warnings

import bpy

UI_OR_DERIVED = {"window_managers", "screens", "workspaces", "all_ids"}
"""Collections of bpy.data that hold no work of the user's."""

NOT_COMPARED = {"rna_type", "bl_rna", "original", "users", "session_uid", "preview", "depsgraph", "is_evaluated"}
NOT_COMPARED |= {"uv_sculpt"}
"""Of these, `uv_sculpt` is a tool's settings whose brush Blender 4.3 cannot hand out: reading it is a crash."""

GEOMETRY = {"vertices", "edges", "loops", "polygons", "loop_triangles", "vertex_normals", "polygon_normals"}
GEOMETRY |= {"corner_normals", "attributes", "loop_triangle_polygons", "color_attributes"}
"""Of meshes, thousands of entries each; compared as a hash of the coordinates instead."""


@contextlib.contextmanager
def nothing_changes():
    """After the block the file is as it was before it."""
    bpy.context.view_layer.update()
    before = snapshot()
    yield
    assert differences(before, snapshot()) == ({}, [])


def snapshot():
    """{path: value} of every data-block, of the context and of the preferences."""
    with warnings.catch_warnings():
        # Reading everything also reads what newer versions deprecate.
        warnings.simplefilter("ignore")
        return _snapshot()


def _snapshot():
    table = {}
    for kind in bpy.data.bl_rna.properties:
        if kind.type == "COLLECTION" and kind.identifier not in UI_OR_DERIVED:
            for block in getattr(bpy.data, kind.identifier):
                _Walk(table).properties(f"{kind.identifier}/{block.name_full}", block)
    table |= _context()
    for name in ("edit", "filepaths", "system", "view"):
        _Walk(table).properties(f"preferences/{name}", getattr(bpy.context.preferences, name))
    _Walk(table).properties("preferences/cycles", bpy.context.preferences.addons["cycles"].preferences)
    return table


def _context():
    context = bpy.context
    return {
        "context/scene": context.scene.name,
        "context/view_layer": context.view_layer.name,
        "context/active": getattr(context.view_layer.objects.active, "name", None),
        "context/selected": sorted(item.name for item in context.view_layer.objects if item.select_get()),
        "context/filepath": bpy.data.filepath,
        "context/mode": context.mode,
    }


class _Walk:
    """Writes one data-block into the table; structs that were seen are not entered twice."""

    def __init__(self, table):
        self.table, self.seen = table, set()

    def properties(self, path, struct):
        if (struct.as_pointer(), struct.bl_rna.identifier) in self.seen:
            return
        self.seen.add((struct.as_pointer(), struct.bl_rna.identifier))
        is_mesh = isinstance(struct, bpy.types.Mesh)
        if is_mesh:
            self.table[f"{path}/geometry"] = hash(tuple(tuple(vertex.co) for vertex in struct.vertices))
        for rna in struct.bl_rna.properties:
            if rna.identifier not in NOT_COMPARED and not (is_mesh and rna.identifier in GEOMETRY):
                self.value(f"{path}/{rna.identifier}", rna, getattr(struct, rna.identifier))
        for key in struct.keys() if isinstance(struct, bpy.types.ID) else ():
            self.table[f"{path}/[{key}]"] = str(struct[key])

    def value(self, path, rna, value):
        if rna.type == "POINTER":
            self.struct(path, value)
        elif rna.type == "COLLECTION":
            members = [item for item in value if not _is_trigger_marker(item)]
            self.table[f"{path}#"] = len(members)
            for index, member in enumerate(members):
                self.struct(f"{path}/{index}", member)
        elif getattr(rna, "is_array", False):
            self.table[path] = str([list(part) if hasattr(part, "__len__") else part for part in value])
        else:
            self.table[path] = sorted(value) if isinstance(value, set) else value

    def struct(self, path, struct):
        if isinstance(struct, bpy.types.ID) and not struct.is_embedded_data:
            self.table[path] = f"{struct.bl_rna.identifier} {struct.name_full}"
        elif isinstance(struct, bpy.types.bpy_struct):
            self.properties(path, struct)
        else:
            self.table[path] = repr(struct)


def _is_trigger_marker(item):
    return isinstance(item, bpy.types.TimelineMarker) and item.name.startswith("Xihe")


def data_blocks(table):
    """("objects/Ball", ...) of a snapshot."""
    return {"/".join(path.split("/")[:2]) for path in table}


def differences(before, after):
    """What of `before` is not so in `after`, and which data-blocks came that are not named "Xihe ..."."""
    changed = {path: (value, after.get(path, "gone")) for path, value in before.items() if after.get(path) != value}
    new = data_blocks(after) - data_blocks(before)
    return changed, sorted(block for block in new if not block.split("/")[1].startswith("Xihe "))
