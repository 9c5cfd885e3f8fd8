"""The tutorial's commands run as they stand there, in an empty folder, and print what it quotes.

LUMENMESH names the command; otherwise it is the one that Cargo built. Where results have changed for a good
reason, `python tests/docs/test_tutorial.py` quotes them anew and replaces the pictures: read what it changes.
"""

import os
import re
import shutil
import struct
import subprocess
import tempfile
from pathlib import Path

import pytest
from pages import COMMAND, ROOT, absent, blocks, missing, quoted_anew, same

PAGE = ROOT / "docs/tutorial.md"
REAL = "Real contours"
CONTOURS = Path(os.environ.get("LUMENMESH_SHARED", ROOT.parent / "shared")) / "data/ivus_narco/ivus_rest"


def parts_of(real):
    """The tutorial's blocks that need the real contours, or those that do not."""
    return [block for block in blocks(PAGE.read_text(encoding="utf-8")) if (block.heading == REAL) == real]


def outputs(parts, folder):
    """Runs the blocks one after the other; each with what it printed."""
    assert COMMAND.is_file(), f"{COMMAND} is missing: build it first, or name another in LUMENMESH"
    # The command as a user has it: by name.
    (folder.parent / "bin").mkdir(exist_ok=True)
    shutil.copy2(COMMAND, folder.parent / "bin/lumenmesh")
    environment = {**os.environ, "PATH": f"{folder.parent / 'bin'}{os.pathsep}{os.environ['PATH']}"}
    for block in parts:
        assert block.language == "sh", f"line {block.line}: {block.language}"
        script = ["bash", "-euo", "pipefail", "-c", block.text]
        done = subprocess.run(script, cwd=folder, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, f"{PAGE}:{block.line}: {block.text}{done.stderr}"
        yield block, done.stdout


def run(parts, folder):
    """Runs the blocks; what differs from the page ends the test."""
    for block, said in outputs(parts, folder):
        line = None if block.output is None else missing(block.output, said)
        assert line is None, f"{PAGE}:{block.line}: {block.text}quotes\n{line}\nIt printed\n{said}"


def size(picture):
    """Width and height of a PNG, in pixels."""
    data = picture.read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n"), picture
    return struct.unpack(">II", data[16:24])


def pictures(folder):
    """The pictures that the commands wrote are those of the page: as many, of the same sizes, and not large."""
    for picture in folder.glob("*.png"):
        shown = ROOT / "docs/images" / f"tutorial_{picture.name}"
        assert f"images/{shown.name}" in PAGE.read_text(encoding="utf-8"), f"{shown.name} is not shown"
        assert size(picture) == size(shown) and shown.stat().st_size <= 150_000
        yield picture.name


def test_the_commands_print_what_the_tutorial_quotes(tmp_path):
    parts = parts_of(real=False)
    assert len(parts) > 5 and sum(block.output is not None for block in parts) >= 5
    folder = tmp_path / "work"
    folder.mkdir()
    run(parts, folder)
    assert sorted(pictures(folder)) == ["error.png", "vessel.png"]
    assert {"vessel.vtp", "sections.csv", "vessel.html", "report.html"} <= {
        file.name for file in folder.iterdir()
    }


def test_the_commands_for_real_contours_too(tmp_path):
    if not CONTOURS.is_dir():
        absent(f"{CONTOURS} (LUMENMESH_SHARED names the data's folder)", "LUMENMESH_REQUIRE_DATA")
    parts = parts_of(real=True)
    assert len(parts) >= 3
    folder = tmp_path / "work"
    folder.mkdir()
    shutil.copytree(CONTOURS, folder / "ivus_rest")
    run(parts, folder)
    assert list(pictures(folder)) == ["rest.png"]


def test_what_a_page_quotes_wrongly_is_told():
    said = "frames  20 (no times)\narea    4.878\nvolume  12 mm³\n"
    assert missing(said, said) is None
    assert missing("…\narea    4.878\n…\n", said) is None
    assert missing("frames  20 (no times)\narea    4.877\nvolume  12 mm³\n", said) is None
    for quoted in [
        "frames  20 (no times)\narea    5.2\nvolume  12 mm³\n",
        "frames  21 (no times)\n…\n",
        "frames  20 (no time)\n…\n",
        "…\nvolume  12 mm³\narea    4.878\n…\n",
        "area    4.878\n…\n",
        "frames  20 (no times)\narea    4.878\n",
    ]:
        assert missing(quoted, said) is not None, quoted
    assert same("a -0.2 %", "a -0.3 %") and not same("a 2 %", "a -2 %") and not same("0 lost", "1 lost")
    with pytest.raises(AssertionError, match="does not end"):
        blocks("```sh\nls\n")
    with pytest.raises(AssertionError, match="without a program"):
        blocks("```text\nnothing\n```\n")


def test_a_command_that_fails_or_prints_something_else_is_told(tmp_path):
    folder = tmp_path / "work"
    folder.mkdir()
    with pytest.raises(AssertionError, match=re.escape("no.mat: cannot read")):
        run(blocks("```sh\nlumenmesh info no.mat\n```\n"), folder)
    with pytest.raises(AssertionError, match=r"quotes\s+lumenmesh 1000"):
        run(blocks("```sh\nlumenmesh --version\n```\n\n```text\nlumenmesh 1000.0.0\n```\n"), folder)


def test_quoting_anew_keeps_what_is_left_out():
    said = "one 1\nrow 1.0 0.5\nrow 2.0 0.7\nsum 3\n"
    assert quoted_anew("one 1\n…\nrow 2.0 0.6\n…\n", said) == "one 1\n…\nrow 2.0 0.7\n…\n"
    assert quoted_anew("…\nsum 2\n", said) == "…\nsum 3\n"
    with pytest.raises(AssertionError, match="total"):
        quoted_anew("…\ntotal 2\n", said)


def quote_anew():
    text = PAGE.read_text(encoding="utf-8")
    for real in [False, True]:
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place) / "work"
            folder.mkdir()
            if real:
                shutil.copytree(CONTOURS, folder / "ivus_rest")
            for block, said in outputs(parts_of(real), folder):
                if block.output is not None:
                    text = text.replace(block.output, quoted_anew(block.output, said))
            for picture in folder.glob("*.png"):
                shutil.copyfile(picture, ROOT / "docs/images" / f"tutorial_{picture.name}")
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    quote_anew()
