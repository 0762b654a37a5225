"""The file is whole, needs nothing else, and an installed package can write it."""

import hashlib
import re
import tomllib
from base64 import b64encode
from fnmatch import fnmatch
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import dpmacro.annotation.page as package
from dpmacro.annotation.page.shown import Curves, Shown, Truth
from dpmacro.annotation.page.write import SCRIPTS, write_page
from tests.annotation.page.reading import coloured, data_of, some_stages

FOLDER = Path(package.__file__).parent
HOSTILE = (
    "</script><script>document.title='broken'</script>",
    "<img src=x onerror=\"document.title='broken'\">",
    "<!--<script>&amp;",
)


class Scripts(HTMLParser):
    """The elements that a browser runs or reads as data, with their text as the browser sees it."""

    def __init__(self, document):
        super().__init__()
        self.texts, self.tags, self.within = {}, [], None
        self.feed(document)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        if tag in ("script", "style"):
            self.within = dict(attributes).get("id", tag)
            assert self.within not in self.texts, f"a second {self.within}"
            self.texts[self.within] = ""

    def handle_endtag(self, tag):
        self.within = None

    def handle_data(self, data):
        if self.within:
            self.texts[self.within] += data


def written(path, names=("reach", "grasp", "carry"), dataset="some", **more):
    stages = some_stages(names=names)
    write_page(path, stages, dataset, Shown(**more))
    return path.read_text(encoding="utf-8")


def test_only_the_pages_own_style_and_script_may_run(tmp_path):
    document = written(tmp_path / "page.html")
    texts = Scripts(document).texts
    assert set(texts) == {"style", "data", "script"}
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="(.*?)"', document)
    assert policy.startswith("default-src &#39;none&#39;; img-src data:; style-src ")
    for name in ("style", "script"):
        digest = b64encode(hashlib.sha256(texts[name].encode()).digest()).decode()
        assert f"{name}-src &#39;sha256-{digest}&#39;" in policy.replace("&#43;", "+").replace("&#61;", "=")
    assert "unsafe" not in policy and "http" not in policy
    assert not re.search(r'(src|href)="(?!data:|#)', document), "something would be loaded"


@pytest.mark.parametrize("place", ["names", "dataset", "facts", "reasons", "truth", "camera", "curve"])
def test_text_does_not_break_out(place, tmp_path):
    usual = Scripts(written(tmp_path / "usual.html", facts={"a": "b"})).tags
    stages = some_stages()
    more = {
        "names": {"names": HOSTILE},
        "dataset": {"dataset": HOSTILE[0]},
        "reasons": {"reasons": HOSTILE},
        "truth": {"truth": Truth(stages.labels, HOSTILE, HOSTILE[0])},
        "camera": {"cameras": {HOSTILE[0]: coloured}},
    }.get(place, {})
    more["facts"] = {HOSTILE[0]: HOSTILE[1]} if place == "facts" else {"a": "b"}
    document = written(tmp_path / "page.html", **more)
    if place == "curve":
        shown = Shown(facts={"a": "b"}, curves=(Curves(np.zeros((150, 3)), HOSTILE),))
        write_page(tmp_path / "page.html", stages, "some", shown)
        document = (tmp_path / "page.html").read_text(encoding="utf-8")
        usual = sorted([*usual, "button", "kbd"])
    tags = Scripts(document).tags
    assert sorted(tags) == sorted(usual) and tags.count("script") == 2 and "img" not in tags
    data = data_of(document)
    read = {
        "names": data["names"],
        "dataset": [data["dataset"]],
        "reasons": data["reasons"],
        "truth": data["truth"] and data["truth"]["names"],
        "camera": data["cameras"],
        "curve": [axis["name"] for axis in data["curves"]],
    }
    assert place == "facts" or list(HOSTILE[: len(read[place])]) == read[place]


def test_cameras_share_the_budget(tmp_path):
    stages, path = some_stages(), tmp_path / "page.html"
    sizes = {}
    for budget in (4_000, 40_000):
        shown = Shown(cameras={"one": coloured, "two": coloured})
        write_page(path, stages, "some", shown, budget=budget)
        sheets = [own for row in data_of(path.read_text())["demonstrations"] for own in row["sheets"]]
        sizes[budget] = sum(len(sheet["source"]) for own in sheets for sheet in own)
        assert 0 < sizes[budget] <= budget and len(sheets) == 6
    assert sizes[4_000] < sizes[40_000]


def test_the_number_of_frames_is_chosen(tmp_path):
    stages, path = some_stages(), tmp_path / "page.html"
    for frames in (0, 7):
        write_page(path, stages, "some", Shown(cameras={"one": coloured}), frames)
        rows = data_of(path.read_text())["demonstrations"]
        assert [sum(len(one["frames"]) for one in row["sheets"][0]) for row in rows] == [frames] * 3


def test_a_refused_page_leaves_no_file(tmp_path):
    with pytest.raises(ValueError, match="one has 0 of the 150 images"):
        written(tmp_path / "page.html", cameras={"one": lambda frames: iter(())})
    with pytest.raises(ValueError, match="reasons"):
        written(tmp_path / "page.html", reasons=("only one",))
    assert not list(tmp_path.iterdir())


def test_a_report_stands_below(tmp_path):
    document = written(tmp_path / "page.html", report="<section><h3>Scores</h3></section>")
    assert "<section><h3>Scores</h3></section>" in document and 'href="#report"' in document
    assert 'id="report"' not in written(tmp_path / "page.html")


def test_an_installed_package_has_all_parts():
    table = tomllib.loads((FOLDER.parents[2] / "pyproject.toml").read_text())
    patterns = table["tool"]["setuptools"]["package-data"]["dpmacro.annotation.page"]
    parts = [path.relative_to(FOLDER).as_posix() for path in FOLDER.rglob("*") if path.is_file()]
    kept = [name for name in parts if not name.endswith((".py", ".pyc"))]
    assert {f"scripts/{name}.js" for name in SCRIPTS} | {"page.html.jinja", "style.css"} == set(kept)
    assert all(any(fnmatch(name, pattern) for pattern in patterns) for name in kept)
