"""Pages that programs write from names that others chose: what must not become of such a name."""

from html.parser import HTMLParser

# A file name, a title, a column: it closes tags and attributes, opens scripts, asks templates to calculate.
EVIL = "</style></title><script>alert(1)</script>\"'><img src=x onerror=alert(2)>{{ 7*'7' }}&lt;b&gt;"
EVIL_FILE = EVIL.replace("/", "")  # as a file name


class _Reader(HTMLParser):
    def __init__(self):
        super().__init__(convert_charrefs=True)
        self.text: list[str] = []
        self.found: list[str] = []

    def handle_starttag(self, tag, attrs):
        if tag in ("script", "iframe", "object", "embed", "link", "base", "form", "meta") and not (
            tag == "meta" and {name for name, _ in attrs} <= {"charset", "name", "content"}
        ):
            self.found.append(f"<{tag}>")
        for name, value in attrs:
            if name.startswith("on"):
                self.found.append(f"{tag} {name}")
            if name in ("src", "href", "data") and not (value or "").startswith(("data:image/", "#")):
                self.found.append(f"{tag} {name}={value}")

    def handle_data(self, data):
        self.text.append(data)


def check_page(html: str, *names: str) -> None:
    """Fail where a page has anything that runs or loads, or does not show `names` as they are."""
    reader = _Reader()
    reader.feed(html)
    reader.close()
    assert not reader.found, f"the page runs or loads: {', '.join(reader.found)}"
    text = "".join(reader.text).replace("\u00a0", " ")
    for name in names:
        assert name in text, f"the page does not show {name!r}"
    assert "7777777" not in text
