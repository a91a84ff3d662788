"""`fastmimic report`: writes a run or a comparison as one HTML file."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional

from fastmimic.base.errors import ConfigError
from fastmimic.commands import options as opt
from fastmimic.commands.console import note, put, slow_start

if TYPE_CHECKING:
    from fastmimic.report.html_run import RerunEpisodes


@dataclass(frozen=True, kw_only=True)
class WriteReport:
    """Writes report.html into the folder of a run of 'imitate', 'stitch' or 'deploy', or of 'compare', 'stress' or
    'transfer': one self-contained file with the video, the figures before and after, and interactive plots.

    The two nominal episodes of a run are simulated again for the plots and checked against its metrics.json. Needs
    Jinja2 and Plotly: pip install 'fastmimic[report]'. With viser (pip install 'fastmimic[view]') the file has a 3D
    replay.
    """

    runs: Annotated[Positional[tuple[Path, ...]], opt.option("RUN ...")]
    """Folders of runs."""
    out: Annotated[Path | None, opt.option("FILE.html")] = None
    """File of the report, for a single run. Default: report.html in its folder."""

    def run(self) -> int:
        """Writes the reports; returns the exit status."""
        if not self.runs:
            raise ConfigError("report takes the folder of at least one run")
        if self.out is not None and len(self.runs) > 1:
            raise ConfigError(f"--out names one file, but {len(self.runs)} runs were given; drop it")
        from fastmimic.report.html import REPORT, kind_of, make_report

        for path in self.runs:
            kind_of(path)  # refuses before anything is written
        outs = [self.out if self.out is not None else path / REPORT for path in self.runs]
        outs = [opt.check_writable(out, ".html", ".htm") for out in outs]
        for path, out in zip(self.runs, outs, strict=True):
            with slow_start():
                report = make_report(path, recorded)
            for line in report.missing:
                note(f"fastmimic: warning: {line}")
            report.save(out)
            put(f"report in {out}")
        return 0


def recorded(e: "RerunEpisodes") -> str:
    """The episodes as a page with a 3D replay, before and after side by side.

    Raises:
        ConfigError: viser is not installed or too old.
    """
    from fastmimic.viewer.recording import recorded_page
    from fastmimic.viewer.take import rollout_take
    from fastmimic.viewer.web import require_viser

    require_viser()
    both = [("before", "before: as retargeted", e.motion.target, e.before)]
    if e.after is not None:
        both.append(("after", "after: optimised", e.motion, e.after))
    else:
        both = [("robot", "", e.motion.target, e.before)]
    takes = [rollout_take(rollout, motion, e.robot, e.config, title) for _, title, motion, rollout in both]
    return recorded_page(e.robot, takes, [name for name, *_ in both])
