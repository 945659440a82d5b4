"""Inputs of shader nodes, and the values they have once links are followed, as Cycles reads them.

Links are followed through reroutes, groups and muted nodes. A value that is linked to a texture or to arithmetic may be
anything; values are read as they stand, so animation and drivers are the business of whoever evaluates the tree.
"""

from __future__ import annotations

from typing import Any

import bpy

Groups = tuple[Any, ...]
"""The group nodes that have been entered, outermost first."""


def has_nodes(block: bpy.types.ID) -> bool:
    """Whether a material or world is made of nodes. From 5.0 on all are, and the switch is deprecated."""
    return block.node_tree is not None and (bpy.app.version >= (5, 0, 0) or block.use_nodes)


def origin(socket: Any, groups: Groups) -> tuple[Any, Groups]:
    """Where the value of the input `socket` comes from: an output socket, or an input socket that nothing feeds.

    A muted node without a way through, an empty group and a link that is muted or invalid feed nothing, and then the
    input's own value counts.
    """
    while (out := _linked_output(socket)) is not None:
        node = out.node
        before = socket
        if node.mute:
            through = [link.from_socket for link in node.internal_links if link.to_socket == out]
            socket = through[0] if through else None
        elif node.type == "REROUTE":
            socket = node.inputs[0]
        elif node.type == "GROUP_INPUT" and groups:
            socket, groups = _by_identifier(groups[-1].inputs, out.identifier), groups[:-1]
        elif hasattr(node, "node_tree"):
            socket, groups = _group_output(node, out.identifier), (*groups, node)
        else:
            return out, groups
        if socket is None:
            return before, groups
    return socket, groups


def _linked_output(socket: Any) -> Any:
    """The output socket that a working link brings into the input `socket`; None without one."""
    if not socket.is_linked:
        return None
    working = (link for link in socket.links if link.is_valid and not link.is_muted and link.from_socket.enabled)
    return next((link.from_socket for link in working), None)


def _group_output(node: Any, identifier: str) -> Any:
    """The input of the active Group Output inside the group `node` that feeds its output `identifier`."""
    nodes = node.node_tree.nodes if node.node_tree is not None else ()
    output = next((inner for inner in nodes if inner.type == "GROUP_OUTPUT" and inner.is_active_output), None)
    return None if output is None else _by_identifier(output.inputs, identifier)


def _by_identifier(sockets: Any, identifier: str) -> Any:
    return next((socket for socket in sockets if socket.identifier == identifier), None)


def constant(socket: Any, groups: Groups) -> Any:
    """The value of an input, where it is the same everywhere: a number or a tuple (R, G, B). None: may be anything."""
    found, _ = origin(socket, groups)
    if found.is_output and found.node.type not in ("VALUE", "RGB"):
        return None
    value = found.default_value
    return tuple(value)[:3] if hasattr(value, "__len__") else value


def largest(node: Any, name: str, groups: Groups) -> float | None:
    """The largest channel of the input `name`; 0 where the node has none of that name, None if it may be anything."""
    if name not in node.inputs:
        return 0.0
    value = constant(node.inputs[name], groups)
    if value is None:
        return None
    return float(max(value) if isinstance(value, tuple) else value)


def may_be_positive(node: Any, name: str, groups: Groups) -> bool:
    value = largest(node, name, groups)
    return value is None or value > 0


def is_whole(node: Any, name: str, groups: Groups) -> bool:
    value = largest(node, name, groups)
    return value is not None and value >= 1


def sides(node: Any, groups: Groups) -> list[Any]:
    """The shader inputs that an Add or a Mix Shader lets through: both, but for a mix by a constant 0 or 1."""
    first, second = node.inputs[-2], node.inputs[-1]
    factor = constant(node.inputs[0], groups) if node.type == "MIX_SHADER" else None
    if factor is None or 0 < factor < 1:
        return [first, second]
    return [second if factor >= 1 else first]
