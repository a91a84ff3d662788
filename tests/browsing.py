"""A headless browser for the pages: what it sees, and waiting for what it is to see."""

import io
import shutil
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
SOFTWARE_GL = ("--no-sandbox", "--enable-unsafe-swiftshader")
PATIENCE_S = 180.0
FEW_FRAMES = """
window.requestAnimationFrame = draw => setTimeout(() => draw(performance.now()), 100);
window.cancelAnimationFrame = clearTimeout;
"""


def open_page(browser: Any, width: int, height: int, **options: Any) -> Any:
    """A page that draws ten times a second: without a graphics card, 60 frames would take all cores."""
    context = browser.new_context(viewport={"width": width, "height": height}, **options)
    context.add_init_script(FEW_FRAMES)
    page = context.new_page()
    page.set_default_timeout(1e3 * PATIENCE_S)
    return page


def plainly(server: Any) -> None:
    """Has the pages of viser's server draw without shadows and reflections, which take most of the time."""
    server.scene.configure_environment_map(None)
    server.scene.configure_default_lights(cast_shadow=False)


def until(condition: Callable[[], bool], page: Any) -> None:
    """Waits for a condition while the page goes on."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "the browser did not get there"
        page.wait_for_timeout(100)


def picture(page: Any) -> np.ndarray:
    """The canvas, (h, w, 3)."""
    from PIL import Image

    data = page.locator("canvas").first.screenshot(timeout=1e3 * PATIENCE_S)
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), dtype=np.float64)


def errors_of(page: Any) -> list[str]:
    """A list to which the page's console and its scripts add their errors from now on."""
    wrong: list[str] = []
    page.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    return wrong


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium, or a skip that says what is missing."""
    pytest.importorskip("viser", reason="the extra 'view' is not installed")
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (pip install playwright)")
    executable = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if executable is None:
        pytest.skip(f"no browser: none of {', '.join(BROWSERS)} is installed")
    with api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=executable, args=list(SOFTWARE_GL))
        yield launched
        launched.close()
