"""Debian's Chromium without a window, for tests that look at pages; they are skipped where it is not installed."""

import base64
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

DESKTOP, PHONE = (1280, 900), (390, 844)
A4 = {"paperWidth": 8.27, "paperHeight": 11.69, "printBackground": True, "preferCSSPageSize": True}


def installed() -> bool:
    """Whether the browser and its driver are there."""
    return all(shutil.which(name) for name in ("chromium", "chromedriver"))


@contextmanager
def chromium(profile: Path) -> Iterator[Any]:
    """A browser with a profile of its own, which writes down what it asks for and what it complains of."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    for flag in (
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--enable-unsafe-swiftshader",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        f"--user-data-dir={profile}",
    ):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    try:
        yield driver
    finally:
        driver.quit()


def look(driver: Any, page: Path, size: tuple[int, int], scheme: str = "light") -> None:
    """Open a page at a width, in a colour scheme, and wait until it has settled."""
    phone = size == PHONE
    metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": phone}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    driver.get_log("browser"), driver.get_log("performance")
    driver.get(page.as_uri())


def settled(driver: Any) -> None:
    """Wait until every view that starts by itself is drawn."""
    from selenium.webdriver.support.ui import WebDriverWait

    waiting = 'return document.querySelectorAll("figure[data-starts=yes] .scene:not([data-drawn=yes])").length === 0'
    WebDriverWait(driver, 30).until(lambda one: one.execute_script(waiting))


def complaints(driver: Any) -> list[str]:
    """What the console says beyond plain information."""
    return [one["message"] for one in driver.get_log("browser") if one["level"] in ("SEVERE", "WARNING")]


def requested(driver: Any) -> list[str]:
    """Every address asked for since the last look, but data and blobs, which are parts of the page."""
    events = (json.loads(one["message"])["message"] for one in driver.get_log("performance"))
    urls = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    return [url for url in urls if not url.startswith(("data:", "blob:"))]


def printed(driver: Any) -> bytes:
    """The page on A4, as PDF."""
    return base64.b64decode(driver.execute_cdp_cmd("Page.printToPDF", A4)["data"])
