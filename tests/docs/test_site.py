"""Links, anchors and citations of the documentation lead somewhere, pages are listed, and the site builds."""

import re
import subprocess
import sys
from html.parser import HTMLParser
from urllib.parse import unquote, urldefrag

import pytest
from pages import ROOT, absent

try:
    import markdown_it  # noqa: F401
except ImportError:
    absent("the Python package markdown-it-py", "LUMENMESH_REQUIRE_TOOLS", allow_module_level=True)


def site(*arguments):
    command = [sys.executable, ROOT / "scripts/site.py", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, encoding="utf-8")


def test_nothing_in_the_documentation_is_broken():
    checked = site("--check")
    assert checked.returncode == 0, checked.stderr


SMALL = {
    "docs/SUMMARY.md": "# Summary\n\n[First](../README.md)\n\n- [Second](second.md)\n",
    "README.md": "# First\n\nSee [it](docs/second.md#one-heading) and `docs/second.md`.\n\n    a = b\n",
    "docs/second.md": "# Second\n\n## One heading\n\n## One heading\n\n[up](../README.md) [](#one-heading-1)\n",
    "paper/paper.md": "---\nbibliography: paper.bib\n---\n# Summary\n\nAs @known2020 says.\n",
    "paper/paper.bib": "@article{known2020,\n  title = {Known}\n}\n",
}


def written(folder, files):
    for path, text in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    return folder


def test_a_small_project_is_whole(tmp_path):
    checked = site("--check", "--root", written(tmp_path, SMALL))
    assert checked.returncode == 0, checked.stderr


@pytest.mark.parametrize(
    ("path", "text", "told"),
    [
        ("README.md", "[it](docs/third.md)", "README.md: docs/third.md: there is no file docs/third.md"),
        ("README.md", "[it](docs/Second.md)", "there is no file docs/Second.md"),
        ("README.md", "![it](docs/none.png)", "docs/none.png: there is no file"),
        ("README.md", "[it](../outside.md)", "there is no file ../outside.md"),
        ("README.md", "[it](docs/second.md#another)", "docs/second.md has no heading #another"),
        ("README.md", "[it](#another)", "README.md has no heading #another"),
        ("README.md", "[it](docs/second page.md)", "this is not read as a link: ](docs/second"),
        ("README.md", "`src/gone.rs`", "README.md: there is no src/gone.rs"),
        ("docs/third.md", "# Third", "docs/third.md is not listed in docs/SUMMARY.md"),
        (
            "docs/SUMMARY.md",
            "# S\n\n[a](../README.md)\n\n- [b](second.md)\n- [c](second.md)",
            "is listed 2 times",
        ),
        (
            "docs/SUMMARY.md",
            "# S\n\n[a](../README.md)\n\n- [b](second.md)\n- [c](gone.md)",
            "there is no file docs/gone.md",
        ),
        (
            "paper/paper.md",
            "---\nbibliography: paper.bib\n---\n@known2020 and [@other2021]",
            "@other2021 is not in paper",
        ),
        ("paper/paper.md", "---\nbibliography: paper.bib\n---\nnothing", "known2020 is not cited"),
    ],
)
def test_what_is_broken_is_told(tmp_path, path, text, told):
    checked = site("-o", tmp_path / "site", "--root", written(tmp_path, {**SMALL, path: text}))
    assert checked.returncode == 1 and told in checked.stderr
    assert not (tmp_path / "site").exists()


SOURCES = ["src", "shaders", "capi", "python", "matlab", "examples", "benches"]
ENDINGS = {".rs", ".wgsl", ".h", ".hpp", ".c", ".cpp", ".py", ".pyi", ".m", ".html", ".js"}


def wrong_references(root):
    """Pages, and headings of pages, that comments of the source name and that are not there."""
    files = (
        file for folder in SOURCES for file in sorted((root / folder).rglob("*")) if file.suffix in ENDINGS
    )
    for file in files:
        # A comment goes on in the next line.
        text = re.sub(r"\n\s*(///?!?|#|%|\*)? *", " ", file.read_text(encoding="utf-8"))
        for page, heading in re.findall(r'\b(docs/[\w/]+\.md)`?(?:, (?:section |sections )?"([^"]+)")?', text):
            if not (root / page).is_file():
                yield f"{file.relative_to(root)}: there is no {page}"
            elif heading and not re.search(
                rf"(?m)^#+ {re.escape(heading)}$", (root / page).read_text(encoding="utf-8")
            ):
                yield f'{file.relative_to(root)}: {page} has no heading "{heading}"'


def test_comments_of_the_source_name_pages_and_headings_that_exist():
    assert list(wrong_references(ROOT)) == []


def test_a_comment_that_names_what_is_not_there_is_told(tmp_path):
    code = {
        "src/a.rs": '/// As it stands in `docs/second.md`,\n/// "One heading".\n',
        "src/b.rs": '//! Wrong: docs/second.md,\n//! "Another"; `docs/third.md`.\n',
    }
    assert list(wrong_references(written(tmp_path, {**SMALL, **code}))) == [
        'src/b.rs: docs/second.md has no heading "Another"',
        "src/b.rs: there is no docs/third.md",
    ]


class Links(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.links, self.anchors = [], set()
        self.feed(text)

    def handle_starttag(self, _, attributes):
        for name, value in attributes:
            if name in ("href", "src"):
                self.links.append(value)
            elif name == "id":
                self.anchors.add(value)


def dead_links(folder):
    """Links of a built site that lead nowhere, as a browser that opens it from a disk sees them."""
    pages = {file: Links(file.read_text(encoding="utf-8")) for file in folder.rglob("*.html")}
    for file, page in pages.items():
        for link in page.links:
            path, anchor = urldefrag(link)
            if path.startswith(("https:", "http:")):
                continue
            target = (file.parent / unquote(path)).resolve() if path else file
            if not target.is_file() or (anchor and target in pages and anchor not in pages[target].anchors):
                yield file, link


def test_the_site_needs_nothing_but_its_folder(tmp_path):
    built = site("-o", tmp_path / "site")
    assert built.returncode == 0, built.stderr
    folder = (tmp_path / "site").resolve()
    assert list(dead_links(folder)) == []
    method = (folder / "docs/method.html").read_text(encoding="utf-8")
    assert '<pre class="formula"><code>se² = v / (8 √(λρ)) · (1 + h),' in method
    index = (folder / "index.html").read_text(encoding="utf-8")
    assert (
        'href="docs/hosts/index.html"' in index
        and "<table>" in index
        and "http" not in (folder / "style.css").read_text()
    )
    # Built again, the site is replaced; what is no site stays.
    assert site("-o", tmp_path / "site").returncode == 0 and (folder / "index.html").exists()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").write_text("mine")
    refused = site("-o", tmp_path / "mine")
    assert refused.returncode == 1 and (tmp_path / "mine/notes.txt").read_text() == "mine"
    # The comparison finds a link that was broken after the build.
    (folder / "docs/coronary.toml").unlink()
    assert [link for _, link in dead_links(folder)] == ["coronary.toml"]
