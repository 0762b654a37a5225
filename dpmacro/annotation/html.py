"""One HTML page that needs nothing else: tables and inline pictures; no script, no network."""

from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from struct import unpack

__all__ = ["facts", "page", "paragraph", "picture", "section", "table"]

STYLE = """
:root { color-scheme: light dark; --ink: #1d2226; --faint: #5c666f; --line: #d5dade; --paper: #fbfbfa; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e7ea; --faint: #9aa5ae; --line: #3a4249; --paper: #15181b; }
}
body { background: var(--paper); color: var(--ink); font: 16px/1.5 system-ui, sans-serif; margin: 0; }
main { margin: 0 auto; max-width: 1200px; padding: 2rem 1.25rem 4rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 1rem; }
h2 { border-top: 1px solid var(--line); font-size: 1.2rem; margin: 2.5rem 0 .75rem; padding-top: 1.25rem; }
p { max-width: 46rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
caption { caption-side: bottom; color: var(--faint); font-size: .875rem; max-width: 46rem; padding-top: .5rem;
  text-align: left; }
th, td { border-bottom: 1px solid var(--line); padding: .3rem 1.25rem .3rem 0; text-align: right; }
th:first-child { text-align: left; }
tbody th { font-weight: 400; }
dl { display: grid; gap: .15rem 1.25rem; grid-template-columns: max-content 1fr; margin: 0; }
dt { color: var(--faint); }
dd { margin: 0; overflow-wrap: anywhere; }
figure { margin: 0 0 1.5rem; }
img { background: white; border-radius: 6px; box-sizing: border-box; display: block; height: auto;
  max-width: 100%; padding: 8px; }
figcaption { color: var(--faint); font-size: .875rem; margin-top: .35rem; max-width: 60rem; }
"""
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def page(title: str, parts: Iterable[str]) -> str:
    """A whole document: the title, and below it the parts that the functions below return."""
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<title>{escape(title)}</title>
<style>{STYLE}</style>
</head>
<body>
<main>
<h1>{escape(title)}</h1>
{"".join(parts)}</main>
</body>
</html>
"""


def facts(named: Mapping[str, str]) -> str:
    """Names and what they stand for, a line each."""
    lines = (f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>\n" for name, value in named.items())
    return f"<dl>\n{''.join(lines)}</dl>\n"


def section(heading: str, parts: Iterable[str]) -> str:
    """A heading and what follows it."""
    return f"<section>\n<h2>{escape(heading)}</h2>\n{''.join(parts)}</section>\n"


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
