"""One self-contained HTML file: what the reports of a run, a batch and a frontier have in common.

page.html, page.css and page.js are put into it. The page loads nothing, and has the browser forbid it, so that no name
in a scene can make it.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from pathlib import Path
from string import Template

from xihenet.io.whole_files import written_whole

_TEMPLATE = Path(__file__).with_name("page.html")
STYLE, SCRIPT = _TEMPLATE.with_suffix(".css"), _TEMPLATE.with_suffix(".js")
_BEFORE_UNIT = re.compile(r"(<pre.*?</pre>)|(?<=\d) (?=%|(?:ms|s|kB|MB|GB|dB|bytes)\b)", re.DOTALL)


def document(
    heading: str,
    opening: str,
    sections: Sequence[tuple[str, str, str]],
    *,
    title: str = "",
    has_links: bool = True,
    style: Path | None = None,
    script: Path | None = None,
) -> str:
    """The page as text; all arguments are HTML.

    Parameters
    ----------
    heading, opening : what stands above everything else
    sections : anchor, title and content of each
    title : of the browser's window; none takes the heading
    has_links : whether the page's top line has a link to each section
    style : a file on top of what every report has
    script : a file that is run when the page is there; none forbids all scripts
    """
    body = "".join(f'<section id="{anchor}"><h2>{name}</h2>{content}</section>' for anchor, name, content in sections)
    links = "".join(f'<a href="#{anchor}">{name}</a>' for anchor, name, _ in sections)
    return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        heading=heading,
        opening=with_units_kept(opening),
        body=with_units_kept(body),
        title=title or heading,
        nav=f"<nav>{links}</nav>" if has_links else "",
        style="".join(file.read_text(encoding="utf-8") for file in (STYLE, style) if file is not None),
        script="" if script is None else f"<script>{script.read_text(encoding='utf-8')}</script>",
        policy="" if script is None else "; script-src 'unsafe-inline'",
    )


def with_units_kept(words: str) -> str:
    """HTML in which no line ends between a number and its unit; what can be copied as code stays as it is."""
    return _BEFORE_UNIT.sub(lambda found: found[1] or "\N{NARROW NO-BREAK SPACE}", words)


def write_document(path: Path, page: str) -> None:
    with written_whole(path) as beside:
        # Blender's names may hold bytes that are no text; they must not cost the user the report.
        beside.write_bytes(page.encode("utf-8", errors="replace"))


def block(title: str, content: str) -> str:
    """A card with a heading; nothing without content."""
    return f'<section class="block"><h3>{title}</h3>{content}</section>' if content else ""


def png_url(content: bytes) -> str:
    """A picture that is part of the page."""
    return f"data:image/png;base64,{base64.b64encode(content).decode('ascii')}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]], classes: str = "") -> str:
    """A table that scrolls on its own where it is too wide; all cells are HTML, the first of a row is its heading.

    Each cell carries its column's name, so that the style can stack wide tables on a narrow screen. ValueError for a
    row of more or fewer cells than the head.
    """
    names = [re.sub("<[^>]*>", " ", cell).strip() for cell in head]
    heads = "".join(f'<th scope="col">{cell}</th>' for cell in head)
    cells = [[_cell(*pair) for pair in zip(names, row, strict=True)] for row in rows]
    body = "".join(
        f'<tr><th scope="row">{row[0]}</th>{"".join(of[1:])}</tr>' for row, of in zip(rows, cells, strict=True)
    )
    return (
        f'<div class="scroll" tabindex="0"><table class="{classes}"><thead><tr>{heads}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _cell(name: str, content: str) -> str:
    return f'<td data-column="{name}"><span>{content}</span></td>'
