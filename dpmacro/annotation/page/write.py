"""The page itself: template, style, script and data in one file that asks for nothing from outside."""

from base64 import b64encode
from collections.abc import Iterator
from hashlib import sha256
from importlib.resources import files
from pathlib import Path

import numpy as np
from jaxtyping import Int64, UInt8
from jinja2 import Environment, StrictUndefined
from tqdm import tqdm

from dpmacro.annotation.page.contents import as_script, contents
from dpmacro.annotation.page.shown import Images, Shown, check
from dpmacro.annotation.page.sprites import BUDGET, Sheet, chosen_frames, sprites
from dpmacro.annotation.stages import Stages
from dpmacro.utils.files import replacing

__all__ = ["page_text", "write_page"]

SCRIPTS = (
    "data",
    "edits",
    "drawing",
    "pictures",
    "editor",
    "cuts",
    "list",
    "stages",
    "main",
)  # in this order


def write_page(
    path: Path,
    stages: Stages,
    dataset: str,
    shown: Shown | None = None,
    frames: int | None = None,
    budget: int = BUDGET,
) -> None:
    """Write the page on which a person looks at the stages, corrects them and saves the corrections.

    The file is there whole or not at all. It opens from disk, in light and dark, and loads nothing.

    Args:
        path: of the file.
        stages: of all demonstrations.
        dataset: its name, which the corrections tell.
        shown: what stands beside the stages; nothing by default.
        frames: pictures of a demonstration and camera at most; see `chosen_frames` for the default.
        budget: letters (bytes) of all pictures together.

    Raises ValueError where the parts do not fit together.
    """
    shown = shown or Shown()
    check(stages, shown)
    chosen = chosen_frames(stages.lengths, stages.fps, len(shown.cameras), frames, budget)
    left, sheets = budget, list[list[list[Sheet]]]()
    for place, (camera, images) in enumerate(shown.cameras.items()):
        share = left // (len(shown.cameras) - place)
        sheets.append(sprites(_with_progress(images, camera), stages.lengths, chosen, share, camera))
        left -= sum(len(sheet.source) for own in sheets[-1] for sheet in own)
    text = page_text(stages, dataset, shown, sheets)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")


def _with_progress(images: Images, camera: str) -> Images:
    """The same images, with a bar that shows how many of them have been asked for."""

    def counted(frames: Int64[np.ndarray, " _"]) -> Iterator[UInt8[np.ndarray, "_ _ 3"]]:
        with tqdm(desc=f"Images of {camera}", total=len(frames), unit="image") as bar:
            for image in images(frames):
                bar.update()
                yield image

    return counted


def page_text(stages: Stages, dataset: str, shown: Shown, sheets: list[list[list[Sheet]]]) -> str:
    """The whole document."""
    folder = files("dpmacro.annotation.page")
    style = folder.joinpath("style.css").read_text(encoding="utf-8")
    scripts = [folder.joinpath("scripts", f"{name}.js").read_text(encoding="utf-8") for name in SCRIPTS]
    script = "\n".join(['(() => {\n"use strict";', *scripts, "})();"])
    template = folder.joinpath("page.html.jinja").read_text(encoding="utf-8")
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(template).render(
        title=f"Stages of {dataset}",
        policy=_policy(style, script),
        style=style,
        script=script,
        data=as_script(contents(stages, dataset, shown, sheets)),
        facts=shown.facts,
        report=shown.report,
        n_demonstrations=len(stages.lengths),
        n_frames=int(stages.lengths.sum()),
        fps=f"{stages.fps:g}",
        has_truth=shown.truth is not None,
        has_curves=any(curves.names for curves in shown.curves),
        has_cameras=bool(shown.cameras),
    )


def _policy(style: str, script: str) -> str:
    """What the browser may load: pictures within the page, and this style and script by their hashes."""
    hashes = [f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'" for text in (style, script)]
    return (
        f"default-src 'none'; img-src data:; style-src {hashes[0]}; script-src {hashes[1]}; "
        "base-uri 'none'; form-action 'none'"
    )
