"""`fastmimic report`: a run or a comparison as one HTML file."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from fastmimic.base.errors import ConfigError
from fastmimic.commands.console import note, put, slow_start
from fastmimic.commands.options import check_writable

if TYPE_CHECKING:
    from fastmimic.report.html_run import Episodes


@dataclass(frozen=True, kw_only=True)
class Report:
    """Writes report.html into the folder of a run of 'imitate', 'stitch' or 'deploy', or of 'compare', 'stress' or
    'transfer': one file that opens anywhere and loads nothing, with the video, the figures before and after, and
    interactive plots.

    A run's two nominal episodes are run again for the plots, and checked against its metrics.json. Needs Plotly:
    pip install 'fastmimic[report]'. With viser as well, pip install 'fastmimic[view]', the file holds a replay in 3D.
    """

    runs: Annotated[Positional[tuple[Path, ...]], arg(metavar="RUN ...")]
    """Folders of runs."""
    out: Annotated[Path | None, arg(metavar="FILE.html")] = None
    """The file, for a single run; by default report.html in the run's folder."""

    def run(self) -> int:
        """Writes them; returns the exit status."""
        if not self.runs:
            raise ConfigError("report takes the folder of at least one run")
        if self.out is not None and len(self.runs) > 1:
            raise ConfigError(f"--out names one file, and {len(self.runs)} runs were given; leave it out")
        from fastmimic.report.html import REPORT, kind_of, make_report

        for path in self.runs:
            kind_of(path)  # refuses all before it writes any
        outs = [self.out if self.out is not None else path / REPORT for path in self.runs]
        outs = [check_writable(out, ".html", ".htm") for out in outs]
        for path, out in zip(self.runs, outs, strict=True):
            with slow_start():
                report = make_report(path, recorded)
            for line in report.missing:
                note(f"fastmimic: warning: {line}")
            report.save(out)
            put(f"report in {out}")
        return 0


def recorded(e: "Episodes") -> str:
    """The episodes as a page that plays them in 3D, before and after beside each other.

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
