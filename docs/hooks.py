"""What the documentation site makes when it is built: the page of the command line, from the program itself."""

import os
import subprocess
import sys
from typing import Any

MARK = "<!-- verbs -->"
ACTIONS = {"library": [["build"], ["list"], ["show"], ["export"], ["verify"]]}


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Puts each verb's help where the page of the command line has its mark."""
    return markdown.replace(MARK, _verbs()) if MARK in markdown else markdown


def _verbs() -> str:
    from fastmimic.cli import VERBS

    return "\n\n".join(
        f"## {name}\n\n{verb.about[0].upper()}{verb.about[1:]}.\n\n"
        + "\n\n".join(f"```text\n{_help(name, *action)}\n```" for action in ([], *ACTIONS.get(name, ())))
        for name, verb in VERBS.items()
    )


def _help(*words: str) -> str:
    command = [sys.executable, "-m", "fastmimic", *words, "--help"]
    environment = {"COLUMNS": "84", "NO_COLOR": "1", "TERM": "dumb"}
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | environment, check=True)
    return done.stdout.strip()
