"""The page of a deployment: how it ended, its figures, and pictures of its log."""

from pathlib import Path
from typing import Any

from fastmimic.base.errors import ConfigError, DeploymentError
from fastmimic.base.files import read_json
from fastmimic.deploy.log import RESULT, DeploymentLog
from fastmimic.deploy.summary import robot_of, summary_rows, with_result
from fastmimic.report.episode_figures import deployment_figure
from fastmimic.report.html_page import HtmlReport, Picture, render, said_arguments


def deployment_page(path: Path) -> HtmlReport:
    """The page of a deployment's folder; raises `FastMimicError`."""
    missing, pictures = [], []
    try:
        try:
            log = DeploymentLog.load(path)
            if log.facts.cut_off:
                log = with_result(robot_of(log), log)
            about = log.facts.as_dict()
            pictures.append(Picture.of(deployment_figure(log, f"{about['motion']} on {about['robot']}"), "log"))
        except DeploymentError as error:
            if not (path / RESULT).is_file():
                raise
            missing.append(f"{error}: without the pictures")
            about = read_json(path / RESULT)
        title = f"{about['motion']} on {about['robot']}, deployed by driver {about['driver']}"
        summary = dict(summary_rows(about["result"]))
        arguments = said_arguments(about.get("arguments", {}))
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(f"{path}: not the figures and the log of a deployment ({error})") from None
    shown: dict[str, Any] = {"about": about, "summary": summary, "arguments": arguments, "pictures": pictures}
    return render("deployment.html", title=title, missing=missing, **shown)
