"""Virtual objects: which of a scene's objects are virtual?

Virtual objects are what the phone would insert: they live in the collection `Xihe Virtual`, and everything outside it
is the room. A collection was chosen over a custom property because it shows in the outliner, hides as one and can be
excluded from a view layer; a naming rule was rejected because it breaks when an object is renamed.

The panel asks this at every redraw, so nothing here needs NumPy. Not here: hiding the objects for a capture, and the
worlds that light them.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence

import bpy

from xihe_blender.errors import UserError

COLLECTION_NAME = "Xihe Virtual"
NAME_PATTERN = re.compile(rf"{COLLECTION_NAME}(\.\d{{3,}})?")
"""Names are unique in a file: of two scenes, the second one's collection is "Xihe Virtual.001"."""

GEOMETRY_TYPES = frozenset({"MESH", "CURVE", "SURFACE", "FONT", "META", "VOLUME", "CURVES", "POINTCLOUD"})
HOMES = "xihe_homes"
"""Custom property of a virtual object: names of the collections of the room that it was in, where there is more to know
than that it was in the master collection. Names, since the collections would follow the object into other files.

Of the collection of virtual objects: the same by name of each collection that was moved into it whole, as is LENT."""

LENT = "xihe_lent"
"""Custom property of a virtual object: names of other scenes that showed it by a collection that it was taken out of,
and now show it by their master collection."""

HOLDER_TYPES = frozenset({"EMPTY", "ARMATURE"})
"""Kinds of objects that hold the parts of a model together, and show up in no render."""

MANY_PARTS = 8
"""Of a model: from so many on, their light and pictures, one for each, are worth a warning."""


def virtual_collection(scene: bpy.types.Scene, *, create: bool = False) -> bpy.types.Collection | None:
    """The collection of virtual objects in `scene`, at any level below its master collection; None without one.

    One of another scene in the same file is not found. `create` makes it if it is missing; one that another scene
    shows stays that scene's.
    """
    found = [c for c in scene.collection.children_recursive if NAME_PATTERN.fullmatch(c.name)]
    if found:
        return min(found, key=lambda collection: collection.name)
    if not create:
        return None
    # A file that was appended to may hold the collection without any scene that shows it.
    collection = bpy.data.collections.get((COLLECTION_NAME, None))
    if collection is None or any(collection in other.collection.children_recursive for other in bpy.data.scenes):
        collection = bpy.data.collections.new(COLLECTION_NAME)
    scene.collection.children.link(collection)
    return collection


def virtual_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Objects with renderable geometry in the virtual collection and its children, sorted by name.

    Lights, cameras and plain empties are left out; an empty that instances a collection counts. Whether an object is
    hidden is not asked, because capture hides them itself. Empty without a collection.
    """
    return sorted(filter(has_renderable_geometry, in_virtual_collection(scene)), key=lambda item: item.name)


def in_virtual_collection(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """All objects in the virtual collection and its children, with or without geometry."""
    collection = virtual_collection(scene)
    return [] if collection is None else list(collection.all_objects)


def make_virtual(scene: bpy.types.Scene, objects: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Move `objects` from the room of `scene` into its virtual collection, made if needed.

    An object is taken out of every collection of the room, since one that is in both would be captured and light
    itself; collections of other scenes keep it. Parents, children and transforms stay as they are. Objects without
    renderable geometry (lamps, cameras) are left where they are; for one that holds others together see `with_parts`.

    Gives those that are virtual now. UserError, with nothing changed, for an object in a collection of another file,
    for a part of one that overrides such a collection (those move as a whole, with their lamps and cameras), and where
    the collection of virtual objects is one itself.
    """
    chosen = [item for item in with_parts(scene, objects) if has_renderable_geometry(item)]
    virtual, room = collections_of(scene)
    _check_are_own(chosen, [*virtual, *room])
    _check_can_change(scene, chosen)
    overrides = _overrides_of(chosen, room)
    layers = [] if virtual else map(listed, scene.view_layers)
    hiding = [layer for layer in layers if not set(chosen) & set(layer.objects)]
    collection = virtual_collection(scene, create=bool(chosen))
    if collection is not None:
        for layer in hiding:
            layer.layer_collection.children[collection.name].exclude = True
    if overrides:
        assert collection is not None
        homes_of = {moved.name: [home.name for home in _holding(scene, moved)] for moved in overrides}
        lent_to = {moved.name: _move(scene, moved, [collection]) for moved in overrides}
        for mark, names in ((HOMES, homes_of), (LENT, lent_to)):
            collection[mark] = json.dumps(json.loads(collection.get(mark, "{}")) | names)
    virtual, room = collections_of(scene)
    for item in chosen:
        assert collection is not None
        # Linked before it is unlinked, so that it stays selected.
        if not virtual & set(item.users_collection):
            collection.objects.link(item)
        homes = room & set(item.users_collection)
        if homes and item.library is None:  # An object that is linked cannot remember anything.
            item.pop(HOMES, None)
            if homes != {scene.collection}:
                item[HOMES] = json.dumps(sorted(home.name for home in homes))
        showing = [other for other in item.users_scene if other.library is None]
        for home in homes:
            home.objects.unlink(item)
        others = [other for other in showing if item not in set(other.objects)]
        for other in others:
            other.collection.objects.link(item)
        if others and item.library is None:
            item[LENT] = json.dumps([other.name for other in others])
    return chosen


def make_room(scene: bpy.types.Scene, objects: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Move virtual `objects` back into the room of `scene`; gives those that were virtual.

    Into the collections that `make_virtual` took them out of, where those are still there, else the master collection.
    UserError as in `make_virtual`.
    """
    virtual, room = collections_of(scene)
    chosen = [item for item in with_parts(scene, objects) if virtual & set(item.users_collection)]
    _check_are_own(chosen, [*virtual, *room])
    _check_can_change(scene, chosen)
    collection = virtual_collection(scene)
    homes_of, lent_to = ({} if collection is None else json.loads(collection.get(mark, "{}")) for mark in (HOMES, LENT))
    for moved in _overrides_of(chosen, virtual):
        known = [home for home in room if home.name in homes_of.get(moved.name, ()) and home.library is None]
        _move(scene, moved, known or [scene.collection])
        for other in map(bpy.data.scenes.get, lent_to.get(moved.name, ())):
            held = [] if other is None else _holding(other, moved)
            if len(held) > 1 and other.collection in held:
                other.collection.children.unlink(moved)
    virtual, room = collections_of(scene)
    for item in chosen:
        if not room & set(item.users_collection):
            names = json.loads(item.get(HOMES, "[]"))
            homes = [home for home in room if home.name in names and home.library is None]
            for home in homes or [scene.collection]:
                home.objects.link(item)
        if item.library is None:
            item.pop(HOMES, None)
            for other in map(bpy.data.scenes.get, json.loads(item.pop(LENT, "[]"))):
                own = set() if other is None else set(other.collection.objects)
                if item in own and any(item in set(c.objects) for c in other.collection.children_recursive):
                    other.collection.objects.unlink(item)
        for home in virtual & set(item.users_collection):
            home.objects.unlink(item)
    return chosen


def _overrides_of(
    chosen: Sequence[bpy.types.Object], collections: Iterable[bpy.types.Collection]
) -> list[bpy.types.Collection]:
    """Those of `collections` that hold any of `chosen` and override a collection of another file.

    Blender takes no object out of such a one: UserError where not all that it holds is chosen.
    """
    found = []
    for home in (home for home in collections if home.override_library is not None):
        inside = [item for item in home.all_objects if has_renderable_geometry(item)]
        left = [item.name for item in inside if item not in chosen]
        if len(left) == len(inside):
            continue
        if left:
            raise UserError(
                f"collection {home.name!r} overrides one of another file, and can only be moved as a whole: "
                f"select {left[0]!r} too"
            )
        found.append(home)
    return found


def _move(scene: bpy.types.Scene, moved: bpy.types.Collection, homes: Collection[bpy.types.Collection]) -> list[str]:
    """Move a collection from wherever it hangs in `scene` below `homes`; one in another that moves goes with that.

    Gives the names of other scenes that showed it by a collection of both, and now do by their master collection.
    """
    above = _holding(scene, moved)
    if any(parent.override_library is not None for parent in above):
        return []
    showing = [other for other in bpy.data.scenes if other.library is None and _holding(other, moved)]
    # Linked before it is unlinked, so that its objects stay selected.
    for home in set(homes).difference(above):
        home.children.link(moved)
    for parent in set(above).difference(homes):
        parent.children.unlink(moved)
    lost = [other for other in showing if not _holding(other, moved)]
    for other in lost:
        other.collection.children.link(moved)
    return [other.name for other in lost]


def _holding(scene: bpy.types.Scene, held: bpy.types.Collection) -> list[bpy.types.Collection]:
    return [c for c in (scene.collection, *scene.collection.children_recursive) if held in set(c.children)]


def listed(layer: bpy.types.ViewLayer) -> bpy.types.ViewLayer:
    """`layer`, with its collections and objects: in Blender 5 one of a scene that was never shown has none before."""
    if layer.layer_collection is None:
        layer.update()
    return layer


def with_parts(scene: bpy.types.Scene, objects: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """`objects`, what has renderable geometry below the empties and armatures among them, and the hair on all of these.

    Imported models hang on empties and armatures. Hair curves are an object of their own, unlike hair of particles.
    """
    given = list(objects)
    holders = {item for item in given if item.type in HOLDER_TYPES and not has_renderable_geometry(item)}
    parts = scene.objects if holders else ()
    below = [item for item in parts if holders.intersection(ancestors(item)) and has_renderable_geometry(item)]
    found = dict.fromkeys([*given, *below])
    grown = scene.objects if bpy.data.hair_curves else ()
    return [*dict.fromkeys([*found, *(item for item in grown if item.type == "CURVES" and item.data.surface in found)])]


def ancestors(item: bpy.types.Object) -> Iterator[bpy.types.Object]:
    above = item.parent
    while above is not None:
        yield above
        above = above.parent


def collections_of(scene: bpy.types.Scene) -> tuple[set[bpy.types.Collection], set[bpy.types.Collection]]:
    """The collections of virtual objects, and those of the room."""
    collection = virtual_collection(scene)
    virtual = set() if collection is None else {collection, *collection.children_recursive}
    return virtual, {scene.collection, *scene.collection.children_recursive} - virtual


def rendered_collections(scene: bpy.types.Scene) -> set[bpy.types.Collection]:
    """Those that renders show, the scene's own among them."""
    found, enabled = set(), [scene.collection]
    while enabled:
        collection = enabled.pop()
        found.add(collection)
        enabled += [child for child in collection.children if not child.hide_render]
    return found


def _check_are_own(objects: Sequence[bpy.types.Object], collections: Sequence[bpy.types.Collection]) -> None:
    """UserError if one of `objects` is in a collection that only its own file can change."""
    for home in (home for home in collections if home.library is not None):
        for item in objects:
            if home in item.users_collection:
                raise UserError(
                    f"object {item.name!r} is in collection {home.name!r}, which is linked from another file: "
                    "make that local first (Object > Relations > Make Local)"
                )


def _check_can_change(scene: bpy.types.Scene, objects: Sequence[bpy.types.Object]) -> None:
    """UserError if `objects` are to go into or out of a collection of virtual objects that is a library override."""
    collection = virtual_collection(scene)
    if objects and collection is not None and collection.override_library is not None:
        raise UserError(
            f"collection {collection.name!r} overrides one of another file, so that nothing can be put into it or "
            "taken out: make it local first (right-click it in the Outliner, ID Data > Make Local)"
        )


def has_renderable_geometry(object: bpy.types.Object) -> bool:
    """Whether `object` shows up in a render by itself, as geometry or as an instancing empty."""
    if object.type == "EMPTY":
        return object.instance_type == "COLLECTION" and object.instance_collection is not None
    return object.type in GEOMETRY_TYPES


def is_bare_curve(item: bpy.types.Object) -> bool:
    """Whether it is a curve that nothing makes a surface of."""
    if item.type != "CURVE" or item.modifiers or item.data.bevel_depth or item.data.extrude or item.data.bevel_object:
        return False
    is_filled = item.data.dimensions == "2D" and item.data.fill_mode != "NONE"
    return not (is_filled and any(spline.use_cyclic_u for spline in item.data.splines))


def models_of_many_parts(objects: Iterable[bpy.types.Object]) -> Iterator[tuple[str, int, str]]:
    """What holds a model together, how many of `objects` hang on it, and what to do, for models of many parts."""
    hangs_on = Counter([*ancestors(item)][-1].name for item in objects if item.parent is not None)
    for root, n_parts in hangs_on.items():
        if n_parts >= MANY_PARTS:
            said = (
                f"{n_parts} virtual objects hang on {root!r}, and a run lights and renders them one by one: join them"
            )
            yield root, n_parts, f"{said} (Object > Join) if they are one model"
