"""What the documentation site makes when it is built: the command line's page, the tables of parameters, formulas."""

import os
import re
import subprocess
import sys
from typing import Any

MARK = "<!-- verbs -->"
PARAMETERS = "<!-- parameters -->"
FORMULA = re.compile(r"^```math\n(.*?)^```$", re.DOTALL | re.MULTILINE)
ACTIONS = {"library": [["build"], ["list"], ["show"], ["export"], ["verify"]]}


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Puts each verb's help, and the tables of parameters, where a page has their marks."""
    for mark, made in ((MARK, _verbs), (PARAMETERS, parameter_tables)):
        if mark in markdown:
            markdown = markdown.replace(mark, made())
    return FORMULA.sub(_formula, markdown)


def _formula(found: re.Match[str]) -> str:
    """A formula as MathML, which browsers set without scripts or fonts from elsewhere."""
    from latex2mathml.converter import convert

    # browsers align columns by their style alone
    formula = re.sub('columnalign="(left|right)"', r'style="text-align: \1"', convert(found[1], display="block"))
    return f'<div style="overflow-x: auto">{formula}</div>'


def parameter_tables() -> str:
    """A table for each class of settings, Markdown."""
    from fastmimic.base.text import markdown_table
    from fastmimic.control import config
    from fastmimic.deploy.safety import SafetyLimits
    from fastmimic.estimation.config import EstimatorConfig
    from fastmimic.learning.config import PolicyConfig
    from fastmimic.reference.regulator_config import RegulatorConfig
    from fastmimic.simulation.config import SensorConfig

    controller = (
        *(config.ControllerConfig, config.GaitConfig, config.StanceConfig, config.HorizonConfig),
        *(config.SwingConfig, RegulatorConfig, config.LoadConfig),
    )
    header = ("parameter", "default", "unit", "range", "meaning")
    lines = []
    for kind in (*controller, EstimatorConfig, SensorConfig, PolicyConfig, SafetyLimits):
        about = str(kind.__doc__).split("\n\n")[0].strip()
        lines += [f"## {kind.__name__}", "", about, "", *markdown_table(header, describe(kind)), ""]
    return "\n".join(lines)


def describe(kind: type) -> list[tuple[str, str, str, str, str]]:
    """Rows of a table: name, default, unit, range and meaning of each parameter."""
    from fastmimic.base.configuration import parameters

    rows = []
    for name, (known, default) in parameters(kind).items():
        shown = ", ".join(f"{v:g}" for v in default) if isinstance(default, tuple) else default
        text = f"{shown:g}" if isinstance(shown, float) else str(shown)
        rows.append((name, text, known.unit, known.range() if not isinstance(default, bool) else "", known.about))
    return rows


def _verbs() -> str:
    from fastmimic.cli import GROUPS

    parts = []
    for group, verbs in GROUPS.items():
        parts.append(f"## {group[0].upper()}{group[1:]}")
        for name, verb in verbs.items():
            parts.append(f"### {name}\n\n{verb.about[0].upper()}{verb.about[1:]}.")
            parts += [f"```text\n{_help(name, *action)}\n```" for action in ([], *ACTIONS.get(name, ()))]
    return "\n\n".join(parts)


def _help(*words: str) -> str:
    command = [sys.executable, "-m", "fastmimic", *words, "--help"]
    environment = {"COLUMNS": "84", "NO_COLOR": "1", "TERM": "dumb"}
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | environment, check=True)
    return done.stdout.strip()
