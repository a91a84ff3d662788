"""The pictures of docs/gallery.md: frames of videos, and pages in a headless browser.

    python benchmarks/gallery.py [--only steer …]

Each is made by the command that stands below it on the page, with built-in motions alone. Needs Chromium, playwright
and the extra `view`. Pages are drawn by the processor where there is no graphics card: minutes.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
FASTMIMIC = (sys.executable, "-m", "fastmimic")
WIDE, NARROW = (1280, 720), (390, 780)
MOST_BYTES = 90_000
WAIT_S = 60.0  # for a scene that the processor draws


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=list(PICTURES))
    wanted = parser.parse_args().only
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        fastmimic("imitate", "canter", "--iterations", "1", "--out", "run")
        for name in wanted:
            PICTURES[name](name)
            print(f"{name}.jpg: {(IMAGES / f'{name}.jpg').stat().st_size // 1000} kB", flush=True)


def fastmimic(*arguments: str) -> None:
    subprocess.run([*FASTMIMIC, *arguments], check=True, stdout=subprocess.DEVNULL)


def keep(picture: Image.Image, name: str) -> None:
    """As a JPEG that is small enough for the repository."""
    quality = 90
    while quality > 30:
        picture.convert("RGB").save(IMAGES / f"{name}.jpg", quality=quality, optimize=True, progressive=True)
        if (IMAGES / f"{name}.jpg").stat().st_size <= MOST_BYTES:
            return
        quality -= 5


def frame(*arguments: str, at: float = 0.8) -> Any:
    """The frame at a share of the video of `fastmimic render`."""

    def take(name: str) -> None:
        fastmimic("render", *arguments, "--out", f"{name}.gif", "--quality", "high", "--size", "1280x560")
        with Image.open(f"{name}.gif") as video:
            video.seek(int(at * (getattr(video, "n_frames", 1) - 1)))
            keep(video, name)

    return take


def page(*arguments: str, size: tuple[int, int] = WIDE, keys: tuple[str, ...] = ()) -> Any:
    """What a command serves, after holding some keys."""

    def take(name: str) -> None:
        with served(*arguments) as address:
            shoot(address, name, size, keys)

    return take


def report(name: str) -> None:
    fastmimic("report", "run", "--out", "report.html")
    shoot(f"file://{Path('report.html').resolve()}", name, (1280, 1040), ())


def shoot(address: str, name: str, size: tuple[int, int], keys: tuple[str, ...]) -> None:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--enable-unsafe-swiftshader"]
        )
        tab = browser.new_page(viewport={"width": size[0], "height": size[1]})
        tab.goto(address)
        tab.wait_for_timeout(1e3 * (WAIT_S if address.startswith("http") else 8.0))
        for notice in tab.locator(".mantine-Notification-closeButton").all():  # of drawing without a graphics card
            notice.click()
        for key in keys:
            tab.keyboard.down(key)
        tab.wait_for_timeout(8e3 if keys else 0)
        tab.screenshot(path=f"{name}.png", timeout=3e5)
        browser.close()
    keep(Image.open(f"{name}.png"), name)


@contextmanager
def served(*arguments: str) -> Iterator[str]:
    """The address of a page while its command runs."""
    process = subprocess.Popen([*FASTMIMIC, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        assert process.stdout is not None
        for line in process.stdout:
            if found := re.search(r"http://\S+", line):
                yield found.group()
                return
        raise SystemExit(f"fastmimic {' '.join(arguments)}: no address")
    finally:
        process.terminate()
        process.wait()


PICTURES = {
    "render": frame("canter", "--duration", "2"),
    "terrain": frame("trot", "--terrain", "stairs-up=0.05", "--duration", "3"),
    "view": page("view", "run"),
    "play": page("play", "trot", "pace", "turn"),
    "steer": page("play", "steer", "--terrain", "rough=0.02", keys=("ArrowUp",)),
    "phone": page("play", "trot", "pace", "turn", size=NARROW),
    "report": report,
}


if __name__ == "__main__":
    main()
