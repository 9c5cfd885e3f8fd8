"""Every command and option of lumenmesh that the documentation or a help names is one that the command has."""

import functools
import re
import shlex
import subprocess

import pytest
from pages import COMMAND, ROOT, blocks

PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "python/README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]


@functools.cache
def help_of(*words):
    done = subprocess.run([COMMAND, *words, "--help"], capture_output=True, text=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    return done.stdout


@functools.cache
def usage(*words):
    """The options of a command, and the names of its commands."""
    text = help_of(*words)
    options = re.findall(r"(?m)^\s+(-\w)?(?:, )?(--[\w-]+)?", text)
    subcommands = re.search(r"(?ms)^Commands:\n(.*?)\n\n", text)
    names = re.findall(r"(?m)^  ([a-z]\S*)", subcommands.group(1)) if subcommands else []
    return {option for pair in options for option in pair if option}, [name for name in names if name != "help"]


def commands(*words):
    """All commands that have no commands of their own, by their words."""
    names = usage(*words)[1]
    return [command for name in names for command in commands(*words, name)] if names else [words]


def lines(text):
    """The command lines of lumenmesh in a page: of its programs for a shell, and between backticks."""
    for block in blocks(text):
        if block.language in ("sh", "bash"):
            whole = re.sub(r"\s*\\\n\s*", " ", block.text)
            yield from re.findall(r"(?m)(?:^|&& *)(lumenmesh [^\n]*)", whole)
    prose = re.sub(r"(?ms)^```.*?^```", "", text)
    yield from re.findall(r"`(lumenmesh [a-z][^`]*)`", " ".join(prose.split()))


def wrong(line):
    """What the command does not have of a command line, or None."""
    # What follows the command in a shell is not its own.
    line = re.split(r"\s(?:#|\||&&|>|2>)(?:\s|$)", line)[0].rstrip("&; ")
    words = shlex.split(line.replace("…", ""))[1:]
    path, (options, names) = [], usage()
    while words and names and not words[0].startswith("-"):
        if words[0] not in names:
            return f"there is no command {' '.join([*path, words[0]])}"
        path.append(words.pop(0))
        options, names = usage(*path)
    for word in words:
        option = word.partition("=")[0]
        if re.fullmatch(r"-[a-zA-Z]|--[a-z][\w-]*", option) and option not in options:
            return f"{' '.join(path)} has no option {option}"
    return None


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_names_commands_and_options_that_exist(page):
    found = {line: wrong(line) for line in lines(page.read_text(encoding="utf-8"))}
    assert {line: fault for line, fault in found.items() if fault} == {}


@pytest.mark.parametrize("words", commands() if COMMAND.is_file() else [], ids=" ".join)
def test_the_examples_of_a_help_have_commands_and_options_that_exist(words):
    # A line may be wrapped; then the rest of it is not looked at.
    examples = re.findall(r"(?m)^  (lumenmesh .*)$", help_of(*words))
    assert {line: fault for line in examples if (fault := wrong(line))} == {}


def test_the_pages_have_command_lines():
    assert len(commands()) > 15
    assert len({line for page in PAGES for line in lines(page.read_text(encoding="utf-8"))}) > 60


def test_the_commands_of_the_page_on_sections_run(tmp_path):
    made = [
        "simulate --vessel stenosis --steady -o pullback.mat",
        "reconstruct pullback.mat -o vessel.vtp",
    ]
    page = [
        line for line in lines((ROOT / "docs/sections.md").read_text(encoding="utf-8")) if "vessel.vtp" in line
    ]
    assert len(page) >= 5
    for line in [*(f"lumenmesh {words}" for words in made), *page]:
        command = [COMMAND, *shlex.split(line, comments=True)[1:]]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, encoding="utf-8")
        assert done.returncode == 0, f"{line}\n{done.stderr}"
    assert {"axis.vtp", "sections.csv"} <= {file.name for file in tmp_path.iterdir()}


def test_what_the_command_does_not_have_is_told():
    assert wrong("lumenmesh simulate --vessel aorta -o a.mat   # a recording") is None
    assert wrong("lumenmesh import pullback a.csv --upright -o a.mat") is None
    assert wrong("lumenmesh evaluate a.vtp --truth b.vtp --json > a.json") is None
    assert wrong("lumenmesh simulat -o a.mat") == "there is no command simulat"
    assert wrong("lumenmesh import pulback a.csv") == "there is no command import pulback"
    assert wrong("lumenmesh simulate --vesel aorta") == "simulate has no option --vesel"
    assert wrong("lumenmesh info a.mat -o b.mat") == "info has no option -o"
    assert list(lines("```sh\nlumenmesh a \\\n  --b\n```\nSee `lumenmesh\nc`.\n")) == [
        "lumenmesh a --b",
        "lumenmesh c",
    ]
