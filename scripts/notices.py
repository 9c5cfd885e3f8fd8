#!/usr/bin/env python3
"""Writes THIRD_PARTY_NOTICES: all packages that the command and the libraries link, with their licences.

usage: notices.py [-o FILE]        # default: THIRD_PARTY_NOTICES
       notices.py --check [FILE]   # exit status 1, and what differs, where FILE is not what would be written

What is linked comes from `cargo tree`: the dependencies of the workspace's members with all features, on Linux,
macOS and Windows, without those that only build or test. Texts come from the packages' own files. Where a
package offers several licences, the first of PREFERRED is taken. Needs the sources of all packages:
`cargo fetch --locked`.
"""

import argparse
import difflib
import json
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OUTPUT = ROOT / "THIRD_PARTY_NOTICES"
PLATFORMS = [
    "x86_64-unknown-linux-gnu",
    "aarch64-unknown-linux-gnu",
    "aarch64-apple-darwin",
    "x86_64-pc-windows-msvc",
]
PREFERRED = ["MIT", "Zlib", "ISC", "BSD-2-Clause", "BSD-3-Clause", "Unicode-3.0", "Apache-2.0"]
LICENCE_FILE = re.compile(r"(licen[cs]e|copying|unlicense|notice|copyright)([-._].*)?", re.IGNORECASE)
SOURCES = {".rs", ".toml", ".json", ".py", ".html"}
# What each licence, and nothing else, says.
SAYS = {
    "MIT": "permission is hereby granted, free of charge, to any person obtaining",
    "Zlib": "this software is provided 'as-is', without any express or implied warranty",
    "ISC": "with or without fee is hereby granted, provided that the above copyright notice",
    "0BSD": "with or without fee is hereby granted. the software is provided",
    "BSD-2-Clause": "redistribution and use in source and binary forms",
    "Apache-2.0": "terms and conditions for use, reproduction, and distribution",
    "BSL-1.0": "boost software license - version 1.0",
    "Unlicense": "this is free and unencumbered software released into the public domain",
    "Unicode-3.0": "unicode license v3",
}
HEAD = """\
Third-party notices of lumenmesh

The packages below are linked into the command `lumenmesh` or into its libraries for C, C++ and Python, on one
or another platform, beside Rust's standard library (MIT or Apache-2.0, https://github.com/rust-lang/rust). A
package that offers several licences is used under the one that stands here. Texts that are equal but for line
breaks stand once. The font DejaVu Sans, which draws the words in pictures, comes with the package `dejavu`.

Written by scripts/notices.py: do not edit.
"""


class NoticesError(Exception):
    """What keeps the notices from being written."""


def cargo(*arguments):
    run = subprocess.run(["cargo", *arguments], cwd=ROOT, capture_output=True, text=True, encoding="utf-8")
    if run.returncode != 0:
        raise NoticesError(
            f"cargo {arguments[0]} failed (did `cargo fetch --locked` run?):\n{run.stderr.strip()}"
        )
    return run.stdout


def linked():
    """Packages that are linked into the members' artefacts: no members, no procedural macros, no tools."""
    same = ["--offline", "--locked", "--all-features"]
    platforms = [word for platform in PLATFORMS for word in ("--target", platform)]
    tree = ["--workspace", "--edges", "normal,no-proc-macro", "--prefix", "none", "--format", "{p}"]
    lines = cargo("tree", *same, *platforms, *tree).splitlines()
    names = {tuple(line.split()[:2]) for line in lines if line}
    graph = json.loads(cargo("metadata", *same, "--format-version", "1"))
    members = set(graph["workspace_members"])
    packages = [package for package in graph["packages"] if package["id"] not in members]
    found = [package for package in packages if (package["name"], f"v{package['version']}") in names]
    return sorted(found, key=lambda package: (package["name"], package["version"]))


def chosen(expression):
    """The licences that apply where, of each choice in an SPDX expression, the first of PREFERRED is taken."""
    licences = []
    for part in re.split(r"\s+AND\s+", expression):
        choices = re.split(r"\s+OR\s+|/", part.strip(" ()"))
        known = [licence for licence in PREFERRED if licence in choices]
        if not known:
            raise NoticesError(f"none of {choices} is in PREFERRED of scripts/notices.py")
        licences.append(known[0])
    return licences


def words(text):
    return " ".join(text.split()).lower()


def kind(text):
    """The one licence whose text a file holds; None for a notice, several licences, or one not in SAYS."""
    licences = [licence for licence, phrase in SAYS.items() if phrase in words(text)]
    return licences[0] if len(licences) == 1 else None


def texts_of(package):
    """The texts of the package that must be passed on, by the licences that it is used under."""
    folder = Path(package["manifest_path"]).parent
    licences = chosen(package["license"])
    offered = set(re.split(r"\s+OR\s+|\s+AND\s+|/", package["license"].replace("(", "").replace(")", "")))
    texts = []
    for path in sorted(folder.rglob("*")):
        if not LICENCE_FILE.fullmatch(path.name) or path.suffix in SOURCES or not path.is_file():
            continue
        text = path.read_text(encoding="utf-8", errors="replace").replace("\r\n", "\n").strip("\n")
        # A choice that is not taken need not be passed on.
        if kind(text) in licences or kind(text) not in offered:
            texts.append(text)
    for licence in {"MIT", "Apache-2.0"}.intersection(licences):
        if not any(SAYS[licence] in words(text) for text in texts):
            texts.append(standard(package, licence))
    if not texts:
        raise NoticesError(f"{package['name']} {package['version']} has no file with the text of {licences}")
    return licences, texts


def standard(package, licence):
    """The text of a licence whose package has no file of it."""
    if licence == "Apache-2.0":
        text = (ROOT / "LICENSE-APACHE").read_text(encoding="utf-8")
        return re.split(r"(?<=END OF TERMS AND CONDITIONS)", text)[0].strip("\n")
    authors = ", ".join(re.sub(r"\s*<[^>]*>", "", author) for author in package["authors"])
    holder = authors or f"the authors of {package['name']}"
    text = (ROOT / "LICENSE-MIT").read_text(encoding="utf-8")
    return re.sub(r"(?m)^Copyright .*$", f"Copyright (c) {holder}", text).strip("\n")


def notices():
    by_text, texts = defaultdict(list), {}
    lines = [HEAD]
    for package in linked():
        licences, own = texts_of(package)
        name = f"{package['name']} {package['version']}"
        lines.append(", ".join(filter(None, [f"{name}: {' and '.join(licences)}", package["repository"]])))
        for text in own:
            texts.setdefault(words(text), text)
            by_text[words(text)].append(name)
    for key, names in by_text.items():
        lines += ["", "=" * 112, ", ".join(dict.fromkeys(names)), "", texts[key]]
    wrapped = "\n".join(line.rstrip() for line in "\n".join(lines).splitlines())
    return wrapped + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=OUTPUT)
    parser.add_argument(
        "--check", nargs="?", type=Path, const=OUTPUT, metavar="FILE", help="compare, write nothing"
    )
    arguments = parser.parse_args()
    try:
        new = notices()
    except NoticesError as error:
        sys.exit(f"error: {error}")
    if arguments.check is None:
        arguments.output.write_text(new, encoding="utf-8")
        return
    old = arguments.check.read_text(encoding="utf-8") if arguments.check.exists() else ""
    if old != new:
        names = str(arguments.check), "as it would be written"
        difference = difflib.unified_diff(old.splitlines(), new.splitlines(), *names, lineterm="", n=0)
        print("\n".join(list(difference)[:40]))
        sys.exit(f"error: {arguments.check} is not up to date: run scripts/notices.py")


if __name__ == "__main__":
    main()
