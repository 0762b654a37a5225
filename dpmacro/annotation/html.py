"""Markup of a report's parts, where no text becomes markup: sections, tables and inline pictures."""

from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape
from struct import unpack

__all__ = ["paragraph", "picture", "section", "table"]


def section(heading: str, parts: Iterable[str]) -> str:
    """A heading and what follows it."""
    return f"<section>\n<h3>{escape(heading)}</h3>\n{''.join(parts)}</section>\n"


def paragraph(text: str) -> str:
    """Plain text."""
    return f"<p>{escape(text)}</p>\n"


def table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "") -> str:
    """A table whose first column names the rows; numbers stand on the right."""
    titles = "".join(f'<th scope="col">{escape(title)}</th>' for title in head)
    lines = []
    for name, *cells in rows:
        values = "".join(f"<td>{escape(cell)}</td>" for cell in cells)
        lines.append(f'<tr><th scope="row">{escape(name)}</th>{values}</tr>\n')
    text = f"<caption>{escape(caption)}</caption>\n" if caption else ""
    body = f"<thead><tr>{titles}</tr></thead>\n<tbody>\n{''.join(lines)}</tbody>\n"
    return f'<div class="wide"><table>\n{text}{body}</table></div>\n'


def picture(png: bytes, alt: str, caption: str = "") -> str:
    """A PNG within the page; `alt` says what it shows to those who cannot see it."""
    width, height = unpack(">II", png[16:24])  # the header's first chunk
    source = f"data:image/png;base64,{b64encode(png).decode()}"
    image = f'<img src="{source}" width="{width}" height="{height}" alt="{escape(alt)}">'
    text = f"\n<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f"<figure>\n{image}{text}\n</figure>\n"
