"""What the server offers, as an OpenAPI document and as a page for people."""

from __future__ import annotations

import json
from functools import cache
from importlib import resources
from typing import Any

from .._version import __version__
from ..report.plain import html_text as escape

EXAMPLE = {"object": "mug", "task": "pour", "hand": "shadow"}
_ERRORS = {
    "400": "The request cannot be used; the reason says what to change (exit code 2 of the command line).",
    "401": "A token is needed.",
    "403": "The request names another host, or comes from a page of another site.",
    "408": "The request came too slowly.",
    "411": "The body has no Content-Length, or comes in chunks.",
    "413": "The body is too large: a request may have 1 MB, a mesh 200 MB.",
    "500": "A file, the disk or the environment failed (exit code 3).",
    "503": "All planners are busy and too many requests wait, or the server is ending; ask again.",
    "504": "The answer took longer than --timeout allows.",
}
_STYLE = (
    "body{font:16px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}"
    "code,pre{font-family:monospace;background:#f2f4f7}pre{padding:.8em;overflow:auto}"
    "table{border-collapse:collapse}td,th{border-top:1px solid #ccd;padding:.3em .6em;text-align:left;"
    "vertical-align:top}"
)


def _schema(name: str) -> dict[str, Any]:
    text = (resources.files("preshape") / "schema" / f"{name}.schema.json").read_text(encoding="utf-8")
    found: dict[str, Any] = json.loads(text)
    return found


@cache
def document() -> dict[str, Any]:
    """The OpenAPI document."""

    def content(schema: dict[str, Any], kind: str = "application/json", **more: Any) -> dict[str, Any]:
        return {"content": {kind: {"schema": schema, **more}}}

    def reference(name: str) -> dict[str, Any]:
        return {"$ref": f"#/components/schemas/{name}"}

    wrong = {code: {"description": words, **content(reference("Error"))} for code, words in _ERRORS.items()}
    request = {"anyOf": [reference("Request"), {"$ref": "urn:preshape:plan:2#/$defs/request"}]}
    state = {name: {"type": "integer"} for name in ("workers", "busy", "waiting")}
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "preshape",
            "version": __version__,
            "description": "Plans of grasps for objects and tasks. Closing the connection cancels a request.",
        },
        "security": [{}, {"token": []}],
        "paths": {
            "/plan": {
                "post": {
                    "summary": "Plan a preshape for an object and a task.",
                    "requestBody": {"required": True, **content(request, example=EXAMPLE)},
                    "responses": {
                        "200": {
                            "description": "The plan; its status says whether there is an answer.",
                            **content(reference("Plan")),
                        },
                        **wrong,
                    },
                }
            },
            "/objects": {
                "post": {
                    "summary": "Send a mesh or a point cloud; requests then name it as their object.",
                    "parameters": [
                        {
                            "name": "name",
                            "in": "query",
                            "required": True,
                            "description": "Name of the file; its ending says the format.",
                            "schema": {"type": "string"},
                        }
                    ],
                    "requestBody": {
                        "required": True,
                        **content({"type": "string", "format": "binary"}, "application/octet-stream"),
                    },
                    "responses": {
                        "201": {
                            "description": "The mesh is kept, until the server ends or needs the room.",
                            **content({"type": "object", "properties": {"object": {"type": "string"}}}),
                        },
                        **{code: wrong[code] for code in wrong if code not in ("503", "504")},
                    },
                }
            },
            "/health": {
                "get": {
                    "summary": "State of the server.",
                    "responses": {
                        "200": {
                            "description": "Numbers of planners, of those at work, and of waiting requests.",
                            **content(
                                {
                                    "type": "object",
                                    "properties": {
                                        "status": {"const": "ok"},
                                        "version": {"type": "string"},
                                        **state,
                                    },
                                }
                            ),
                        }
                    },
                }
            },
            "/openapi.json": {
                "get": {"summary": "This document.", "responses": {"200": {"description": "OpenAPI 3.1."}}}
            },
        },
        "components": {
            "schemas": {
                "Request": _schema("request"),
                "Plan": _schema("plan"),
                "Error": {"$ref": "urn:preshape:plan:2#/$defs/error"},
            },
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
    }


@cache
def page() -> str:
    """The document as a page that loads nothing else."""
    content = document()
    parts = [f"<h1>preshape {escape(__version__)}</h1><p>{escape(content['info']['description'])}</p>"]
    for path, methods in content["paths"].items():
        for method, operation in methods.items():
            parts.append(
                f"<h2><code>{method.upper()} {escape(path)}</code></h2><p>{escape(operation['summary'])}</p>"
            )
            if path == "/plan":
                sent = escape(json.dumps(EXAMPLE))
                parts.append(f"<pre>curl http://ADDRESS/plan -d '{sent}'</pre>")
                parts.append(_table(("key", "default", "meaning"), _keys(content)))
            answers = ((code, answer["description"]) for code, answer in operation["responses"].items())
            parts.append(_table(("status", "answer"), answers))
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>preshape serve</title>'
        f'<meta name="viewport" content="width=device-width"><style>{_STYLE}</style></head><body>'
        + "".join(parts)
        + '<p>All of it, with the schema of plans, as <a href="openapi.json">OpenAPI 3.1</a>.</p>'
        "</body></html>"
    )


def _keys(content: dict[str, Any]) -> list[tuple[str, str, str]]:
    schema = content["components"]["schemas"]["Request"]
    return [
        (
            name,
            json.dumps(entry["default"]) if "default" in entry else "(needed)",
            entry["description"],
        )
        for name, entry in schema["properties"].items()
    ]


def _table(columns: tuple[str, ...], rows: Any) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"
