"""The papers of a release: third-party notices, and the version that pages and citation name."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def notices(*arguments):
    return subprocess.run(
        [sys.executable, ROOT / "scripts/notices.py", *arguments], capture_output=True, text=True
    )


def test_the_notices_are_those_of_the_packages_that_are_linked():
    checked = notices("--check")
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_a_package_that_is_not_named_is_told(tmp_path):
    names = re.compile(r"^wgpu \S+: .*\n", re.MULTILINE)
    text, count = names.subn("", (ROOT / "THIRD_PARTY_NOTICES").read_text(encoding="utf-8"))
    assert count == 1
    (tmp_path / "notices").write_text(text, encoding="utf-8")
    checked = notices("--check", str(tmp_path / "notices"))
    assert checked.returncode == 1 and "+wgpu" in checked.stdout and "is not up to date" in checked.stderr
    assert notices("--check", str(tmp_path / "absent")).returncode == 1


def versions(root):
    """The versions that files name: file, version, and how many parts of the package's it has to give."""
    for path, pattern, parts in [
        ("CITATION.cff", r"^version: (\S+)$", 3),
        ("docs/hosts/rust.md", r'^lumenmesh = \{ version = "([\d.]+)"', 2),
        ("docs/hosts/c.md", r"^find_package\(lumenmesh ([\d.]+) ", 2),
    ]:
        found = re.findall(pattern, (root / path).read_text(encoding="utf-8"), re.MULTILINE)
        assert found, f"{path} names no version"
        yield from ((path, version, parts) for version in found)


def wrong_versions(root):
    manifest = (root / "Cargo.toml").read_text(encoding="utf-8")
    package = re.search(r'^version = "([\d.]+)"$', manifest, re.MULTILINE).group(1).split(".")
    return [
        f"{path} names version {version}, Cargo.toml {'.'.join(package)}"
        for path, version, parts in versions(root)
        if version != ".".join(package[:parts])
    ]


def test_pages_and_citation_name_the_version_of_the_package():
    assert wrong_versions(ROOT) == []


def test_another_version_is_told(tmp_path):
    for path in ["Cargo.toml", "CITATION.cff", "docs/hosts/rust.md", "docs/hosts/c.md"]:
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text((ROOT / path).read_text(encoding="utf-8"), encoding="utf-8")
    manifest = (tmp_path / "Cargo.toml").read_text(encoding="utf-8")
    (tmp_path / "Cargo.toml").write_text(
        re.sub(r'(?m)^version = ".*"$', 'version = "99.0.0"', manifest), encoding="utf-8"
    )
    assert len(wrong_versions(tmp_path)) == 3
