"""What stands in pages of the documentation: their programs, and the output that is quoted below them."""

import os
import re
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# The command that Cargo built, or another one.
COMMAND = Path(os.environ.get("LUMENMESH", ROOT / "target/debug/lumenmesh"))


def absent(what, required_by, **how):
    """Skips a test, or a whole module, for what is not there; a failure where the variable is set."""
    if os.environ.get(required_by):
        pytest.fail(f"{what} is missing", pytrace=False)
    pytest.skip(f"{what} is missing", **how)


@dataclass
class Block:
    """A program of a page, with the heading that it stands under and the output below it, if any is quoted."""

    heading: str
    language: str
    text: str
    output: str | None
    line: int


def blocks(text):
    """The fenced blocks of a page; a block of `text` is the output of the one before it."""
    found, heading, start = [], "", None
    lines = text.splitlines()
    for number, line in enumerate(lines, 1):
        fence = re.match(r"```(\w*)", line)
        if start is not None and line == "```":
            language, first = start
            body = "\n".join(lines[first : number - 1]) + "\n"
            if language == "text":
                assert found and found[-1].output is None, f"line {first}: output without a program"
                found[-1].output = body
            else:
                found.append(Block(heading, language, body, None, first + 1))
            start = None
        elif start is None and fence:
            start = fence.group(1), number
        elif start is None and line.startswith("#"):
            heading = line.lstrip("# ")
    assert start is None, "a block that does not end"
    return found


NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
# Processors of other kinds round otherwise, which moves the last of the digits that are printed.
RELATIVE = 0.02


def same(quoted, said):
    """Whether two lines say the same: words alike, numbers within RELATIVE or one in the last digit."""
    if NUMBER.sub("0", quoted).split() != NUMBER.sub("0", said).split():
        return False
    for a, b in zip(NUMBER.findall(quoted), NUMBER.findall(said), strict=True):
        last_digit = 10.0 ** -len(a.partition(".")[2])
        if abs(float(a) - float(b)) > max(RELATIVE * abs(float(a)), 1.001 * last_digit if "." in a else 0.0):
            return False
    return True


def missing(quoted, said):
    """The first quoted line that the output lacks at its place, or None; `…` stands for any number of lines."""
    said, at, anywhere = said.splitlines(), 0, False
    for line in quoted.splitlines():
        if line.strip() == "…":
            anywhere = True
            continue
        places = range(at, len(said)) if anywhere else range(at, min(at + 1, len(said)))
        place = next((k for k in places if same(line, said[k])), None)
        if place is None:
            return line
        at, anywhere = place + 1, False
    return None if anywhere or at == len(said) else f"(nothing more, but there is: {said[at]})"


def quoted_anew(quoted, said):
    """The quoted lines with the numbers of the output: for each, the next line of the same words, if possible with
    the same first number, such as the place of a row in a table."""
    said, at, new = said.splitlines(), 0, []
    for line in quoted.splitlines():
        if line.strip() == "…":
            new.append(line)
            continue
        words, first = NUMBER.sub("0", line).split(), NUMBER.findall(line)[:1]
        alike = [k for k in range(at, len(said)) if NUMBER.sub("0", said[k]).split() == words]
        assert alike, f"the output has no line like: {line}"
        place = next((k for k in alike if NUMBER.findall(said[k])[:1] == first), alike[0])
        new.append(said[place])
        at = place + 1
    return "\n".join(new) + "\n"
