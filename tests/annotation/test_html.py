"""Markup is well-formed and says what it was given, and no text becomes markup."""

from base64 import b64decode
from html.parser import HTMLParser

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from dpmacro.annotation.html import paragraph, picture, section, table
from dpmacro.figures import elbow, to_png

VOID = {"meta", "img", "link", "input"}


class Reader(HTMLParser):
    """Elements with their attributes, and text that is seen; fails where one is not closed in its turn."""

    def __init__(self, document):
        super().__init__()
        self.open, self.elements, self.texts = [], [], []
        self.feed(document)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"script", "style"} & set(self.open):
            self.texts.append(data)

    def of(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]


def test_everything_is_on_the_page():
    png = to_png(elbow(np.array([2.0, 1.0])))
    parts = [
        section(
            "Scores & more", [table(["", "policy"], [["accuracy", "0.9"]], "Of all."), paragraph("Good.")]
        ),
        picture(png, 'the "elbow" <of> it', "What S saves."),
    ]
    reader = Reader("".join(parts))
    text = "".join(reader.texts)
    for expected in (
        "Scores & more",
        "accuracy",
        "0.9",
        "Of all.",
        "Good.",
        "What S saves.",
    ):
        assert expected in text
    (image,) = reader.of("img")
    assert image["alt"] == 'the "elbow" <of> it'
    kind, data = image["src"].split(",", 1)
    assert kind == "data:image/png;base64" and b64decode(data) == png
    assert (int(image["width"]), int(image["height"])) == (864, 432)


@example(["<b>", "<i>&amp;", '"<script>'])
@given(st.lists(st.text("<>&\"'b/ ="), min_size=3, max_size=3))
def test_no_text_becomes_markup(texts):
    name, value, heading = texts
    reader = Reader(section(heading, [table([name, value], [[name, value]]), paragraph(value)]))
    elements = [tag for tag, _ in reader.elements]
    assert elements.count("td") == 1 and elements.count("th") == 3 and elements.count("h3") == 1
    assert not {"script", "b", "i"} & set(elements)
    assert all(text in "".join(reader.texts) for text in texts)
