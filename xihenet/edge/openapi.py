"""The OpenAPI 3.1 description of the routes, which the service gives at /openapi.json."""

from __future__ import annotations

from typing import Any

from xihenet import __version__
from xihenet.codec import METHODS
from xihenet.edge import protocol
from xihenet.edge.axes import AXES

_UUID = {"type": "string", "format": "uuid"}
_FAILURE = {
    "type": "object",
    "required": ["ok", "error"],
    "properties": {"ok": {"const": False}, "error": {"type": "string"}},
}
_COEFFICIENTS = {
    "type": "array",
    "items": {"type": "number"},
    "minItems": 27,
    "maxItems": 27,
    "description": "Radiance coefficients of order 2, nine of red, then green, then blue, in the client's axes.",
}
_TEXT, _COUNT, _TARGET = {"type": "string"}, {"type": "integer"}, {"enum": ["ldr", "hdr"]}
_SESSION = {"name": "session", "in": "path", "required": True, "schema": _UUID}
_POSITION = {
    "name": "position",
    "in": "path",
    "required": True,
    "schema": {"type": "string", "pattern": protocol.POSITION_NAME},
}
_ESTIMATE = {
    "type": "object",
    "required": [
        *("ok", "coefficients", "exposure", "expected_error", "coverage", "is_valid", "unknown_because"),
        *("estimator", "target", "axes", "n_shared_anchors"),
    ],
    "properties": {
        "ok": {"const": True},
        "coefficients": _COEFFICIENTS,
        "exposure": {"type": "number", "description": "That the light carries: divide by it for scene radiance."},
        "expected_error": {"type": ["number", "null"], "description": "SHC RMSE that the estimator expects."},
        "coverage": {"type": "number", "minimum": 0, "maximum": 1},
        "is_valid": {"type": "boolean"},
        "unknown_because": _TEXT,
        "estimator": _TEXT,
        "target": _TARGET,
        "axes": {"enum": list(AXES)},
        "n_shared_anchors": _COUNT,
        "key_light": {"type": ["object", "null"]},
        "reflections": {"type": "object"},
    },
}


def _object(**properties: Any) -> dict[str, Any]:
    """An answer with all of these, by name, as JSON Schema describes them."""
    return {"type": "object", "required": ["ok", *properties], "properties": {"ok": {"const": True}, **properties}}


_JOINED = _object(token=_TEXT, n_anchors=_COUNT, target=_TARGET)
_OPENED = _object(
    session=_UUID,
    token=_TEXT,
    n_anchors=_COUNT,
    target=_TARGET,
    estimator=_TEXT,
    farthest_m={"type": ["number", "null"], "description": "What lies beyond is taken to lie there."},
    knows_unseen={
        "enum": ["never", "with_ambient", "always"],
        "description": "When the light of a cloud without an anchor is known.",
    },
)


def openapi_document(sizes: tuple[int, ...], *, has_bearer: bool) -> dict[str, Any]:
    """Of a service that serves clouds of these `sizes`; with `has_bearer` each route but health needs the token."""
    document: dict[str, Any] = {
        "openapi": "3.1.0",
        "info": {"title": "Xihe edge service", "version": __version__, "license": {"name": "GPL-3.0-or-later"}},
        "paths": {
            protocol.PUBLISHED_SESSION: {"post": _published_session(sizes)},
            protocol.PUBLISHED_ESTIMATION: {"post": _published_estimation()},
            protocol.SESSIONS: {"post": _open(sizes), "get": _of_token("Sessions of the token's holder", [])},
            protocol.SESSIONS + "/{session}": {
                "get": _of_token("What a session knows", [_SESSION]),
                "delete": _of_token("Forget a session; needs its owner's token", [_SESSION]),
            },
            protocol.SESSIONS + "/{session}/clients": {
                "post": _operation("Join a session by its id", [_SESSION], 201, _JOINED, (403, 404, 409, 415))
            },
            protocol.SESSIONS + "/{session}/positions/{position}": {
                "post": _estimate(),
                "delete": _of_token("Forget a position", [_SESSION, _POSITION]),
            },
            "/health": {
                "get": _operation("That the service is there, with its store", [], 200, _object(estimator=_TEXT))
            },
        },
    }
    if has_bearer:
        document["components"] = {"securitySchemes": {"bearer": {"type": "http", "scheme": "bearer"}}}
        document["security"] = [{"bearer": []}]
        document["paths"]["/health"]["get"]["security"] = []
    return document


def _published_session(sizes: tuple[int, ...]) -> dict[str, Any]:
    size = _header("Anchor-Size", {"type": "integer", "enum": list(sizes)}, "Number of anchors.", required=True)
    return _operation("Open a session, as the published client does", [size, _axes("unity")], 200, _object(sid=_UUID))


def _published_estimation() -> dict[str, Any]:
    session = _header("Session-ID", _UUID, "As opening gave it.", required=True)
    answer = {"type": "object", "required": ["ok", "coefficients"], "properties": {"coefficients": _COEFFICIENTS}}
    operation = _operation("Light, of the published records", [session, _axes("unity")], 200, answer, (404, 413, 415))
    return operation | {"requestBody": _binary("application/octet-stream", "Records of seven bytes.")}


def _open(sizes: tuple[int, ...]) -> dict[str, Any]:
    wanted = {
        "type": "object",
        "properties": {
            "n_anchors": {"type": "integer", "enum": list(sizes)},
            "target": _TARGET,
            "joinable": {"type": "boolean"},
        },
        "additionalProperties": False,
    }
    own = _header(
        protocol.TOKEN_HEADER, {"type": "string", "minLength": 16, "maxLength": 128}, "A token to own it by, or none."
    )
    operation = _operation("Open a session", [own], 201, _OPENED, (413, 415))
    return operation | {"requestBody": {"content": {"application/json": {"schema": wanted}}}}


def _estimate() -> dict[str, Any]:
    at, light = (f"{sign}{protocol.NUMBER}" for sign in ("-?", ""))
    position, ambient = ({"type": "string", "pattern": f"^{one}(, ?{one}){{2}}$"} for one in (at, light))
    exposure = {"type": "number", "minimum": 1 / protocol.MAX_EXPOSURE, "maximum": protocol.MAX_EXPOSURE}
    switches = {
        "replace": "Whether the cloud takes the place of what is known, instead of being merged.",
        "share": "Whether directions not seen are filled from other positions; needs the position.",
        "key_light": "Whether to say the key light.",
        "reflections": "Whether to say what glossy things reflect.",
    }
    parameters: list[dict[str, Any]] = [
        _SESSION,
        _POSITION,
        *(
            {"name": name, "in": "query", "schema": {"enum": ["yes", "no"]}, "description": words}
            for name, words in switches.items()
        ),
        _token_header(),
        _header(protocol.EXPOSURE_HEADER, exposure, "Exposure that the colours carry.", required=True),
        _header(protocol.POSITION_HEADER, position, "Of the position, metres, in the client's axes."),
        _header(protocol.AMBIENT_HEADER, ambient, "Radiance of the light sensor, carrying the exposure."),
        _axes("z-up"),
    ]
    refused = (401, 403, 404, 409, 413, 415)
    operation = _operation("The light at a position, of a cloud", parameters, 200, _ESTIMATE, refused)
    words = f"A payload of xihenet.codec, in the method that the content type names: {', '.join(METHODS)}."
    return operation | {"requestBody": _binary(protocol.CLOUD_TYPE, words)}


def _of_token(summary: str, parameters: list[dict[str, Any]]) -> dict[str, Any]:
    statuses = (401, 403, 404) if parameters else (401,)
    return _operation(summary, [*parameters, _token_header()], 200, _object(), statuses)


def _operation(
    summary: str,
    parameters: list[dict[str, Any]],
    status: int,
    answer: dict[str, Any],
    refused: tuple[int, ...] = (),
) -> dict[str, Any]:
    responses = {str(status): {"description": "Done.", "content": {"application/json": {"schema": answer}}}}
    for one in sorted({*refused, 400, 503}):  # Any may have a name that is not known, or no answer of the store.
        content = {"application/json": {"schema": _FAILURE}}
        responses[str(one)] = {"description": "Refused, and why.", "content": content}
    return {"summary": summary, "parameters": parameters, "responses": responses}


def _binary(content_type: str, words: str) -> dict[str, Any]:
    return {"description": words, "required": True, "content": {content_type: {"schema": {"type": "string"}}}}


def _header(name: str, schema: dict[str, Any], words: str, *, required: bool = False) -> dict[str, Any]:
    return {"name": name, "in": "header", "required": required, "schema": schema, "description": words}


def _axes(default: str) -> dict[str, Any]:
    return _header(
        protocol.AXES_HEADER, {"enum": list(AXES), "default": default}, "The client's axes, see docs/edge.md."
    )


def _token_header() -> dict[str, Any]:
    return _header(protocol.TOKEN_HEADER, {"type": "string"}, "As opening or joining gave it.", required=True)
