"""Takes the pictures of the app in docs/app/, with Chromium and its driver, by `make pictures`."""

import io
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from selenium.webdriver import Chrome, ChromeOptions, ChromeService

import commonlaw as cl

HERE = Path(__file__).parent / "app"
SCREEN, PHONE = (1200, 900), (390, 844)


@contextmanager
def served(table: Path) -> Iterator[str]:
    """Yield the address of an app that shows a table."""
    command = [sys.executable, "-m", "commonlaw", "app", "--no-browser", str(table)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().split()[-1]
        finally:
            process.terminate()


def browser(folder: str) -> Chrome:
    """Return a browser without a window."""
    options = ChromeOptions()
    options.binary_location = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    for argument in ("headless=new", "no-sandbox", "disable-gpu", "hide-scrollbars", f"user-data-dir={folder}"):
        options.add_argument(f"--{argument}")
    return Chrome(options, ChromeService(shutil.which("chromedriver")))


def wait(page: Chrome, what: str, seconds: float = 120) -> None:
    """Wait until an expression of the page is true."""
    until = time.monotonic() + seconds
    while not page.execute_script(f"const $ = id => document.getElementById(id); return {what}"):
        if time.monotonic() > until:
            raise TimeoutError(what)
        time.sleep(0.2)


def choose(page: Chrome, name: str, value: str) -> None:
    """Choose a value as somebody does."""
    set_value = "const each = document.getElementById(arguments[0]); each.value = arguments[1];"
    page.execute_script(set_value + "each.dispatchEvent(new Event('change'))", name, value)


def take(page: Chrome, name: str, at: str, size: tuple[int, int]) -> None:
    """Save what a window of this size shows when it is scrolled to an element."""
    width, height = size
    window = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": size == PHONE}
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", window)
    page.execute_script("document.getElementById(arguments[0])?.scrollIntoView()", at)
    time.sleep(1)
    picture = Image.open(io.BytesIO(page.get_screenshot_as_png())).convert("RGB")
    picture.save(HERE / f"{name}.webp", quality=80, method=6)


def main() -> None:
    """Go from a table to a law, and take pictures on the way."""
    HERE.mkdir(exist_ok=True)
    with TemporaryDirectory() as folder:
        table = Path(folder) / "drops.csv"
        cl.datasets.linear_drag(noise=0.05, seed=1).to_csv(table)
        with served(table) as address, browser(f"{folder}/browser") as page:
            page.get(address)
            wait(page, "$('counts')?.textContent.includes('10 trials')")
            for name, value in {"hold_out": "trial", "held": "2"}.items():
                choose(page, name, value)
            take(page, "question", "counts", SCREEN)
            page.find_element("id", "start").click()
            wait(page, "!$('result').hidden && $('going').hidden")
            take(page, "law", "result", SCREEN)
            take(page, "phone", "result", PHONE)


if __name__ == "__main__":
    main()
