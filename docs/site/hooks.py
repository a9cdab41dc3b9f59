"""The documentation site: files of the repository as pages, the links between them, and generated pages.

A page may stand anywhere in the repository and links as on any Git host, relative to itself. Here a link to
another page leads to that page of the site, a picture comes along, and a link to source code leads to a page
that shows the file. Where the site has a generated page in place of a file, such as the commands in place of
the module that lists them, `extra.instead` of mkdocs.yml names that page.
"""

from __future__ import annotations

import json
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import generated  # beside this file
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[2]
FENCE = re.compile(r"^( *)(`{3,}|~{3,}).*?^\1\2 *$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"(?<=\]\()([^)\s]+)(?=\))|(?<=src=\")([^\"]+)(?=\")")
_elsewhere: set[str] = set()  # addresses that pages link to
PICTURES = {".gif", ".png", ".svg"}
LANGUAGES = {".py": "python", ".toml": "toml", ".xml": "xml", ".yml": "yaml"}


@event_priority(100)  # before mkdocstrings looks for it
def on_config(config):
    """Show mkdocstrings the folders as the package `inclined_landing`; it follows no links."""
    package = ROOT / "build" / "package" / "inclined_landing"
    code = {Path("__init__.py"): b""}
    for floor in ("models", "envs", "eval", "train"):
        code |= {file.relative_to(ROOT): file.read_bytes() for file in (ROOT / floor).rglob("*.py")}
    for file, text in code.items():  # what is there stays: another build may be reading it
        copy = package / file
        if not copy.is_file() or copy.read_bytes() != text:
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(text)
    for copy in package.rglob("*.py"):
        if copy.relative_to(package) not in code:
            copy.unlink()
    return config


def on_files(files: Files, config) -> Files:
    """Add what stands outside `docs/`, what pages link to, and what is generated."""
    for path, uri in config.extra["included"].items():
        files.append(File.generated(config, uri, abs_src_path=str(ROOT / path)))
    for file in files.documentation_pages():
        for target in _targets(Path(file.abs_src_path).read_text("utf-8")):
            path, _ = _in_repository(file, target)
            shown = _uris(files) | config.extra["instead"]
            if path and path not in shown and (ROOT / path).is_file():
                files.append(_shown(path, config))
    for uri, text in generated.pages().items():
        files.append(File.generated(config, uri, content=text))
    for path, uri in config.extra["live"].items():
        if (ROOT / path).is_file():
            files.append(File.generated(config, uri, abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, page, config, files: Files) -> str:
    """Turn links of the repository into links of the site; code blocks stay unchanged."""
    if page.file.src_uri in config.extra["unsearched"]:
        page.meta["search"] = {"exclude": True}
    if not page.file.abs_src_path:
        return markdown
    if page.file.src_uri == "index.md":
        markdown = _with_live_pages(markdown, _uris(files))
    uris = _uris(files) | config.extra["instead"]

    def in_site(match: re.Match) -> str:
        path, anchor = _in_repository(page.file, match[0])
        if path not in uris:
            return match[0]
        return posixpath.relpath(uris[path], posixpath.dirname(page.file.src_uri)) + anchor

    pieces, end = [], 0
    for fence in FENCE.finditer(markdown):
        pieces += [LINK.sub(in_site, markdown[end : fence.start()]), fence[0]]
        end = fence.end()
    return "".join([*pieces, LINK.sub(in_site, markdown[end:])])


def on_page_content(html: str, page, config, files: Files) -> None:
    """Note what leads out of the site."""
    _elsewhere.update(re.findall(r'href="(https?://[^"]+)"', html))


def on_post_build(config) -> None:
    """Write the external links into a list next to the site, because mkdocs does not check them."""
    listed = Path(config.site_dir) / "external_links.txt"
    listed.write_text("".join(f"{address}\n" for address in sorted(_elsewhere)), "utf-8")


def _with_live_pages(markdown: str, uris: dict[str, str]) -> str:
    """Return the first page with the replay instead of its picture, and a link to a gap report."""
    if "build/demo/replay.html" in uris:
        frame = '<iframe src="build/demo/replay.html" title="Replay" class="live" loading="lazy"></iframe>'
        markdown = re.sub(r'<img src="docs/replay_page\.png"[^>]*>', frame, markdown)
    if "build/demo/report/report.html" in uris:
        link = "[The report of this example](build/demo/report/report.html)."
        markdown = re.sub(r"(\*The bundled example, .*?\*)", rf"\1 {link}", markdown)
    return markdown


def _targets(markdown: str) -> Iterator[str]:
    """What a page links to, code blocks left out."""
    return (match[0] for match in LINK.finditer(FENCE.sub("", markdown)))


def _in_repository(file: File, target: str) -> tuple[str | None, str]:
    """Where in the repository a link of `file` leads, None for elsewhere, and its anchor."""
    path, mark, anchor = target.partition("#")
    if not path or re.match(r"[a-z][a-z0-9+.-]*:", path):
        return None, ""
    here = Path(file.abs_src_path).relative_to(ROOT).parent.as_posix()
    path = posixpath.normpath(posixpath.join(here, path))
    return f"{path}/README.md" if (ROOT / path / "README.md").is_file() else path, mark + anchor


def _uris(files: Files) -> dict[str, str]:
    """Page or picture of the site by path in the repository."""
    found = {}
    for file in files:
        if file.src_uri.startswith("source/"):
            found[file.src_uri.removeprefix("source/").removesuffix(".md")] = file.src_uri
        elif file.abs_src_path and Path(file.abs_src_path).is_relative_to(ROOT):
            found[Path(file.abs_src_path).relative_to(ROOT).as_posix()] = file.src_uri
    return found


def _shown(path: str, config) -> File:
    """A file that a page links to: a picture unchanged, source code as a page."""
    suffix = PurePosixPath(path).suffix
    if suffix in PICTURES:
        return File.generated(config, path, abs_src_path=str(ROOT / path))
    code = (ROOT / path).read_text("utf-8")
    if suffix == ".ipynb":
        return File.generated(config, f"source/{path}.md", content=_notebook(code))
    longest = max(map(len, re.findall("`+", code)), default=0)
    fence = "`" * max(3, longest + 1)
    opening = fence + LANGUAGES.get(suffix, "text")
    text = f"# {PurePosixPath(path).name}\n\n`{path}`\n\n{opening}\n{code}\n{fence}\n"
    return File.generated(config, f"source/{path}.md", content=text)


def _notebook(text: str) -> str:
    """Markdown of a notebook: its text, and its code in blocks."""
    parts = []
    for cell in json.loads(text)["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
    return "\n\n".join(parts)
