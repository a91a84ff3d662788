"""Tables in the documentation, each between its own pair of markers."""

import re
from pathlib import Path

from fastmimic.base.files import replace_file


def put(path: Path, mark: str, text: str) -> None:
    """Replaces what stands between `<!-- mark:begin -->` and `<!-- mark:end -->`.

    Raises:
        SystemExit: the page does not have the markers exactly once.
    """
    page, found = re.subn(
        rf"(<!-- {mark}:begin -->\n).*?(<!-- {mark}:end -->)",
        lambda m: f"{m[1]}{text}\n{m[2]}",
        path.read_text(encoding="utf-8"),
        flags=re.DOTALL,
    )
    if found != 1:
        raise SystemExit(f"{path}: expected the markers of '{mark}' once, found them {found} times")
    replace_file(path, lambda file: file.write(page.encode()))
