#!/usr/bin/env python3
"""Builds the documentation as a site of plain HTML, which needs neither server nor network.

usage: site.py [-o FOLDER]         # default: target/site; open its index.html
       site.py --check             # build nothing, name what is broken

docs/SUMMARY.md (in mdBook's form) lists the pages in their order. A link to a file that is no page gets a copy
of that file. Nothing is built where a link or an anchor leads nowhere, a page of docs/ is not listed, a page
names a file of the project that is not there, or a citation of paper/paper.md is not in its bibliography. Needs
the Python package markdown-it-py.
"""

import argparse
import html
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from markdown_it import MarkdownIt

ROOT = Path(__file__).resolve().parent.parent
SUMMARY = PurePosixPath("docs/SUMMARY.md")
PAPER = PurePosixPath("paper/paper.md")
# Checked, but not of the site: the paper, which a journal sets, and the page of the Python package.
BESIDE = [PAPER, PurePosixPath("python/README.md")]
ELSEWHERE = re.compile(r"(https?|mailto):")
# Files of the project that a page names without a link; the changelog may name what is gone.
NAMED = re.compile(r"(benches|capi|docs|examples|matlab|paper|python|scripts|shaders|src|tests)/[\w./+-]*")
HISTORY = PurePosixPath("CHANGELOG.md")

STYLE = """\
:root { color-scheme: light dark; --ink: #1c1f23; --faint: #5d6671; --page: #fff; --side: #f5f6f8;
  --line: #d9dde2; --link: #0b5cad; --code: #f3f4f6; }
@media (prefers-color-scheme: dark) { :root { --ink: #dde1e6; --faint: #9aa3ad; --page: #16181b;
  --side: #1c1f23; --line: #343a41; --link: #7db7f5; --code: #22262b; } }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: var(--page);
  font: 16px/1.55 system-ui, "DejaVu Sans", sans-serif; }
a { color: var(--link); text-decoration: none; }
a:hover { text-decoration: underline; }
nav { position: fixed; inset: 0 auto 0 0; width: 16rem; padding: 1.2rem; overflow-y: auto;
  background: var(--side); border-right: 1px solid var(--line); font-size: 0.92rem; }
nav h2 { margin: 1.2rem 0 0.2rem; padding: 0; border: none; font-size: 0.78rem; letter-spacing: 0.04em;
  text-transform: uppercase; color: var(--faint); }
nav ul { margin: 0; padding-left: 0; list-style: none; }
nav ul ul { padding-left: 1rem; }
nav [aria-current] { color: var(--ink); font-weight: 600; }
main { max-width: 58rem; margin-left: 16rem; padding: 1.5rem 2.5rem 4rem; }
h1, h2, h3 { line-height: 1.25; }
h2 { margin-top: 2.2rem; padding-bottom: 0.2rem; border-bottom: 1px solid var(--line); }
.here { visibility: hidden; margin-left: 0.4rem; }
:is(h2, h3, h4):hover .here { visibility: visible; }
pre { padding: 0.8rem 1rem; overflow-x: auto; background: var(--code); border-radius: 6px; line-height: 1.4; }
code { font: 0.88em ui-monospace, "DejaVu Sans Mono", monospace; }
:not(pre) > code { padding: 0.1em 0.3em; background: var(--code); border-radius: 4px; }
pre.formula { padding: 0.2rem 1.6rem; background: none; }
pre.formula code { font-family: "DejaVu Serif", "STIX Two Text", Cambria, serif; font-size: 1em; }
pre:has(> .language-text) { background: none; border: 1px solid var(--line); }
.table { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.92rem; }
th, td { padding: 0.3rem 0.7rem 0.3rem 0; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--line); }
img { max-width: 100%; }
.turn { display: flex; justify-content: space-between; margin-top: 3rem; padding-top: 0.8rem;
  border-top: 1px solid var(--line); }
@media (max-width: 50rem) { nav { position: static; width: auto; } main { margin-left: 0; padding: 1rem; } }
@media print { nav, .turn { display: none; } main { margin: 0; max-width: none; } }
"""


def parser():
    return MarkdownIt("commonmark").enable(["table", "strikethrough"])


class Page:
    """A page's tokens, with the anchors of its headings as GitHub names them."""

    def __init__(self, root, path):
        self.path = path
        text = (root / path).read_text(encoding="utf-8")
        self.head, self.text = re.match(r"(---\n.*?\n---\n)?(.*)", text, re.DOTALL).groups()
        self.tokens = parser().parse(self.text)
        self.anchors = {}
        self.title = str(path)
        for k, token in enumerate(self.tokens):
            if token.type == "heading_open":
                title = "".join(part.content for part in self.tokens[k + 1].children)
                if token.tag == "h1" and not self.anchors:
                    self.title = title
                slug = re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
                count = sum(
                    anchor == slug or re.fullmatch(f"{slug}-\\d+", anchor) is not None
                    for anchor in self.anchors
                )
                anchor = f"{slug}-{count}" if count else slug
                self.anchors[anchor] = title
                token.attrSet("id", anchor)

    def links(self):
        """Each token with a target, and the name of the attribute that holds it."""
        for token in self.tokens:
            for part in token.children or []:
                if part.type in ("link_open", "image"):
                    yield part, "href" if part.type == "link_open" else "src"


def target_of(page, link):
    """The path in the repository that a link leads to, and its anchor."""
    path, _, anchor = link.partition("#")
    place = os.path.normpath(page.path.parent / unquote(path)) if path else str(page.path)
    return PurePosixPath(place), unquote(anchor)


def exists(root, path):
    """Whether a file is there under exactly this name: systems differ in whether case counts."""
    here = root
    for part in path.parts:
        if part == ".." or not here.is_dir() or part not in os.listdir(here):
            return False
        here = here / part
    return True


def entries(summary):
    """The summary's parts: (depth, None, title of a group), or (depth, link, title of a page)."""
    depth = 0
    for k, token in enumerate(summary.tokens):
        depth += {"bullet_list_open": 1, "bullet_list_close": -1}.get(token.type, 0)
        if token.type == "heading_open" and k > 0:
            yield 0, None, summary.tokens[k + 1].content
        for n, part in enumerate(token.children or []):
            if part.type == "link_open":
                yield depth, part.attrs["href"], token.children[n + 1].content


def broken(root, summary, pages):
    """What is wrong, one line each."""
    listed = [target_of(summary, link)[0] for _, link, _ in entries(summary) if link]
    for path in sorted(set(listed)):
        if listed.count(path) > 1:
            yield f"{SUMMARY}: {path} is listed {listed.count(path)} times"
    for file in sorted((root / "docs").rglob("*.md")):
        path = PurePosixPath(file.relative_to(root).as_posix())
        if path != SUMMARY and path not in listed:
            yield f"{path} is not listed in {SUMMARY}"
    for page in [summary, *pages.values()]:
        for token, attribute in page.links():
            link = token.attrs[attribute]
            if ELSEWHERE.match(link):
                continue
            path, anchor = target_of(page, link)
            if not exists(root, path):
                yield f"{page.path}: {link}: there is no file {path}"
            elif anchor and path.suffix == ".md":
                known = pages[path].anchors if path in pages else Page(root, path).anchors
                if anchor not in known:
                    yield f"{page.path}: {link}: {path} has no heading #{anchor}"
        yield from unclosed(page)
        if page.path != HISTORY:
            yield from unknown_files(root, page)
    if PAPER in pages:
        yield from broken_citations(root, pages[PAPER])


def unclosed(page):
    """Links that Markdown does not see as such, for want of their target or of a bracket."""
    for token in page.tokens:
        for part in token.children or []:
            for found in re.findall(r"\]\([^)\s]*|\]\[[^\]]*\]", part.content if part.type == "text" else ""):
                yield f"{page.path}: this is not read as a link: {found}"


def unknown_files(root, page):
    for token in page.tokens:
        for part in token.children or []:
            named = part.type == "code_inline" and NAMED.fullmatch(part.content)
            if named and not exists(root, PurePosixPath(part.content)):
                yield f"{page.path}: there is no {part.content}"


def broken_citations(root, paper):
    bibliography = paper.path.parent / re.search(r"(?m)^bibliography: (\S+)$", paper.head).group(1)
    known = set(re.findall(r"(?m)^@\w+\{([^,]+),", (root / bibliography).read_text(encoding="utf-8")))
    cited = set(re.findall(r"(?<![\w.])@([\w:-]+)", paper.text))
    for key in sorted(cited - known):
        yield f"{paper.path}: @{key} is not in {bibliography}"
    for key in sorted(known - cited):
        yield f"{bibliography}: {key} is not cited in {paper.path}"


def output_of(path):
    """Where a page goes: README.md is its folder's index."""
    return path.with_name("index.html") if path.name == "README.md" else path.with_suffix(".html")


def relative(page, target):
    return os.path.relpath(target, output_of(page.path).parent)


def sidebar(page, summary):
    lines, depth = [], 0
    for level, link, title in entries(summary):
        lines += ["<ul>"] * (max(level, 1) - depth) if link else []
        lines += ["</ul>"] * (depth - (max(level, 1) if link else 0))
        depth = max(level, 1) if link else 0
        if link is None:
            lines.append(f"<h2>{html.escape(title)}</h2>")
            continue
        path, _ = target_of(summary, link)
        current = ' aria-current="page"' if path == page.path else ""
        lines.append(f'<li><a href="{relative(page, output_of(path))}"{current}>{html.escape(title)}</a></li>')
    return "\n".join(lines + ["</ul>"] * depth)


def turn(page, order):
    """Links to the pages before and after."""
    at = order.index(page)
    before = order[at - 1] if at > 0 else None
    after = order[at + 1] if at + 1 < len(order) else None
    sides = [
        (
            f'<a href="{relative(page, output_of(other.path))}">{arrow.format(html.escape(other.title))}</a>'
            if other
            else "<span></span>"
        )
        for other, arrow in [(before, "← {}"), (after, "{} →")]
    ]
    return f'<div class="turn">{"".join(sides)}</div>'


def body(page, pages, copies):
    """The page's HTML; adds to `copies` the files that it links to."""
    for token, attribute in page.links():
        link = token.attrs[attribute]
        if ELSEWHERE.match(link):
            continue
        path, anchor = target_of(page, link)
        target = output_of(path) if path in pages else path
        if path not in pages:
            copies.add(path)
        token.attrSet(
            attribute,
            "#" + anchor if path == page.path else relative(page, target) + ("#" + anchor if anchor else ""),
        )
    markdown = parser()
    rules = markdown.renderer.rules
    # Formulas are the blocks that are indented; programs and their output stand between fences.
    rules["code_block"] = (
        lambda tokens, k, *_: f'<pre class="formula"><code>{html.escape(tokens[k].content)}</code></pre>\n'
    )
    rules["table_open"] = lambda *_: '<div class="table"><table>\n'
    rules["table_close"] = lambda *_: "</table></div>\n"
    rules["heading_close"] = lambda tokens, k, *_: (
        f'<a class="here" href="#{tokens[k - 2].attrs["id"]}" aria-label="Here">#</a></{tokens[k].tag}>\n'
    )
    return markdown.renderer.render(page.tokens, markdown.options, {})


def build(root, summary, pages, folder):
    copies = set()
    order = [pages[target_of(summary, link)[0]] for _, link, _ in entries(summary) if link]
    site = {page.path: page for page in order}
    for page in order:
        text = f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{html.escape(page.title)}{"" if page is order[0] else " · lumenmesh"}</title>
<link rel="stylesheet" href="{relative(page, "style.css")}">
</head>
<body>
<nav>
{sidebar(page, summary)}
</nav>
<main>
{body(page, site, copies)}
{turn(page, order)}
</main>
</body>
</html>
"""
        file = folder / output_of(page.path)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    (folder / "style.css").write_text(STYLE, encoding="utf-8")
    for path in copies:
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(root / path, folder / path)


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("-o", "--output", type=Path, default=ROOT / "target/site")
    arguments.add_argument("--check", action="store_true", help="build nothing, name what is broken")
    arguments.add_argument("--root", type=Path, default=ROOT, help="folder of the project")
    arguments = arguments.parse_args()
    root = arguments.root
    summary = Page(root, SUMMARY)
    listed = [target_of(summary, link)[0] for _, link, _ in entries(summary) if link]
    paths = [path for path in [*listed, *BESIDE] if exists(root, path)]
    pages = {path: Page(root, path) for path in paths}
    faults = list(broken(root, summary, pages))
    if faults:
        sys.exit("\n".join(["error: the documentation is broken", *faults]))
    if arguments.check:
        return
    # As a whole: an old site stays as it is until the new one is complete.
    output = arguments.output.resolve()
    if output.exists() and any(output.iterdir()) and not (output / "style.css").exists():
        sys.exit(f"error: {output} holds other files than a site: name a folder that is new, or empty")
    output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=output.parent) as folder:
        new = Path(folder) / "site"
        new.mkdir()
        build(root, summary, pages, new)
        if output.exists():
            output.rename(Path(folder) / "old")
        new.rename(output)
    print(f"wrote {output / 'index.html'}")


if __name__ == "__main__":
    main()
