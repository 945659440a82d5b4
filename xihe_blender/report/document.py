"""What has every report in common? One self-contained file, its headings, blocks and tables.

The page loads nothing, and has the browser forbid it, so that no name in a scene can make it. Used by the reports of a
run, of a batch and of a frontier; what is particular to one of them is with it.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from pathlib import Path

from xihe_blender.io.outputs import written_whole
from xihe_blender.report.style import STYLE

_SAFE = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_SAFE_WITH_SCRIPT = f"{_SAFE}; script-src 'unsafe-inline'"


def document(
    heading: str, opening: str, body: str, *, title: str = "", links: str = "", style: str = "", script: str = ""
) -> str:
    """The page as text; all arguments are HTML.

    Parameters
    ----------
    heading, opening : what stands above everything else
    title : of the browser's window; none takes the heading
    links : to places in the page, right of its top line; none leaves them out
    style : on top of what every report has
    script : run when the page is there; none forbids all scripts
    """
    nav = f"<nav>{links}</nav>" if links else ""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{_SAFE_WITH_SCRIPT if script else _SAFE}">'
        f"<title>{title or heading}</title><style>{STYLE}{style}</style></head>"
        f'<body><div class="page"><header><div class="eyebrow"><span>AR lighting previsualisation</span>{nav}</div>'
        f"<h1>{heading}</h1>{opening}</header><main>{body}</main></div>"
        f"{f'<script>{script}</script>' if script else ''}</body></html>\n"
    )


def write_document(path: Path, page: str) -> None:
    """Write it whole or not at all."""
    with written_whole(path) as beside:
        # Blender's names may hold bytes that are no text; they must not cost the user the report.
        beside.write_bytes(page.encode("utf-8", errors="replace"))


def section(anchor: str, title: str, content: str) -> str:
    """A part of the page that links can go to."""
    return f'<section id="{anchor}"><h2>{title}</h2>{content}</section>'


def link(anchor: str, title: str) -> str:
    return f'<a href="#{anchor}">{title}</a>'


def block(title: str, content: str) -> str:
    """A card with a heading; nothing without content."""
    return f'<section class="block"><h3>{title}</h3>{content}</section>' if content else ""


def png_url(content: bytes) -> str:
    """A picture that is part of the page."""
    return f"data:image/png;base64,{base64.b64encode(content).decode('ascii')}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]], classes: str = "") -> str:
    """A table that scrolls on its own where it is too wide; all cells are HTML, the first of a row is its heading.

    Each cell carries its column's name, so that the style can stack wide tables on a narrow screen.
    """
    names = [re.sub("<[^>]*>", " ", cell).strip() for cell in head]
    heads = "".join(f'<th scope="col">{cell}</th>' for cell in head)
    body = "".join(f'<tr><th scope="row">{row[0]}</th>{"".join(map(_cell, names[1:], row[1:]))}</tr>' for row in rows)
    return (
        f'<div class="scroll" tabindex="0"><table class="{classes}"><thead><tr>{heads}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _cell(name: str, content: str) -> str:
    return f'<td data-column="{name}"><span>{content}</span></td>'
