"""Reports as Markdown and as one HTML file that needs nothing else."""

from __future__ import annotations

import base64
from html.parser import HTMLParser
from pathlib import Path

import pytest
from redundancy_pin.experiments.document import Bullets, FileLink, Heading, Paragraph, Picture, table
from redundancy_pin.experiments.html import html
from redundancy_pin.experiments.markdown import markdown

from redundancy_pin.errors import OutputError

PIXELS = b"\x89PNG not really"
BLOCKS = [
    Heading("Title & more", 1),
    Paragraph("a < b, `code`"),
    Heading("Part <two>"),
    Bullets(("one", "two")),
    table(("where", "verdict"), [(FileLink("run", "run.csv"), "differs: x | y"), ("<script>", "reproduced")], "said"),
    Picture("picture.png", 'a "caption"'),
]


class Seen(HTMLParser):
    """Collects every element with its attributes, and the text."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture
def page(tmp_path: Path) -> Seen:
    (tmp_path / "picture.png").write_bytes(PIXELS)
    seen = Seen()
    seen.feed(html(BLOCKS, tmp_path))
    return seen


def test_pictures_are_embedded(page: Seen) -> None:
    sources = [attributes["src"] for tag, attributes in page.tags if tag == "img"]
    assert len(sources) == 1
    head, _, data = str(sources[0]).partition(",")
    assert head == "data:image/png;base64"
    assert base64.b64decode(data) == PIXELS


def test_text_is_escaped_and_verdicts_are_coloured(page: Seen) -> None:
    assert not [tag for tag, _ in page.tags if tag in ("script", "two", "link", "iframe")]
    assert "a < b" in page.text
    assert "<script>" in page.text
    assert [attributes.get("class") for tag, attributes in page.tags if tag == "td"] == [None, "bad", None, "good"]
    assert ("code", {}) in page.tags


def test_links_lead_to_headings_of_the_page(page: Seen) -> None:
    links = [str(attributes["href"]) for tag, attributes in page.tags if "href" in attributes]
    anchors = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(links) == 1
    assert all(link.startswith("#") and link[1:] in anchors for link in links)


def test_markdown_links_and_escapes() -> None:
    text = markdown(BLOCKS)
    assert text.startswith("# Title & more\n")
    assert "| [run](run.csv) | differs: x \\| y |" in text
    assert '![a "caption"](picture.png)' in text
    assert "- one\n- two" in text


def test_a_missing_picture_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"picture\.png"):
        html(BLOCKS, tmp_path)
