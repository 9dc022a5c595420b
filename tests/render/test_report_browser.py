"""Reports in Debian's Chromium, on a desk, on a phone and on paper: what is drawn, said, asked for and printed."""

import html
import io
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import browser
import numpy as np
import pytest
import results
from test_html import HOSTILE, hostile

from robacc.render.page import render

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not browser.installed(), reason="chromium and chromedriver are not installed"),
    # The browser's own image library and driver warn of what is not this package's.
    pytest.mark.filterwarnings("default"),
]
_HARMLESS = ("willReadFrequently", "GL Driver Message")
"""Advice to the library that draws views, and a remark of graphics without a graphics card."""


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    with tempfile.TemporaryDirectory() as profile, browser.chromium(Path(profile)) as started:
        yield started


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page for each kind of result: an estimate with a gate, a trace with hostile names, and one beside another."""
    place = tmp_path_factory.mktemp("pages")
    documents = {"predict": [results.document("predict")]}
    documents["gated"] = [results.gated(place)]
    documents["compare"] = [results.compared(place)]
    documents["several"] = [results.document("trace"), results.document("iso9283")]
    documents["hostile"] = [hostile(results.document("trace"))]
    for name, parts in documents.items():
        page = render(parts, [f"{name} {i}" for i in range(len(parts))])
        (place / f"{name}.html").write_text(page, encoding="utf-8")
    return place


PAGES = ("predict", "gated", "compare", "several", "hostile")
DRAWN = """
return Array.from(document.querySelectorAll('figure')).map(function (figure) {
  var part = figure.querySelector('.still').hidden ? figure.querySelector('.scene') : figure.querySelector('svg');
  var box = part.getBoundingClientRect();
  var marks = part.querySelectorAll('path, use, canvas').length;
  return [figure.id, box.width, box.height, box.left, box.right, marks];
});
"""


def check_that_all_is_drawn_and_nothing_asked_for(driver: Any, page: Path, width: int) -> None:
    figures = driver.execute_script(DRAWN)
    assert len(figures) >= (3 if page.stem == "compare" else 6)
    for figure, wide, high, left, right, marks in figures:
        assert wide > 250, figure
        assert high > 120, figure
        assert left >= 0, figure
        assert right <= width, figure
        # A view has its canvases, a still picture its axes and points.
        assert marks >= 1, figure
    # Nothing is cut off sideways, and nothing has to be scrolled there but within a table.
    assert driver.execute_script("return document.documentElement.scrollWidth") <= width
    assert [text for text in browser.complaints(driver) if not any(harmless in text for harmless in _HARMLESS)] == []
    assert browser.requested(driver) == [page.as_uri()]


@pytest.mark.parametrize("name", PAGES)
def test_a_page_on_a_phone_is_drawn_whole_and_its_tables_open(name: str, driver: Any, folder: Path) -> None:
    page = folder / f"{name}.html"
    browser.look(driver, page, browser.PHONE)
    browser.settled(driver)
    check_that_all_is_drawn_and_nothing_asked_for(driver, page, browser.PHONE[0])
    details = driver.find_element("css selector", "figure details")
    table = details.find_element("css selector", "table")
    assert not table.is_displayed()
    details.find_element("css selector", "summary").send_keys("\n")
    assert table.is_displayed()
    assert driver.execute_script("return document.documentElement.scrollWidth") <= browser.PHONE[0]


def pixels_of(driver: Any, selector: str) -> np.ndarray:
    """Pixels of an element."""
    from PIL import Image

    element = driver.find_element("css selector", selector)
    return np.asarray(Image.open(io.BytesIO(element.screenshot_as_png)).convert("RGB")).astype(int)


def check_that_charts_have_ink(driver: Any, *, dark: bool) -> None:
    papers = []
    for figure, *_ in driver.execute_script(DRAWN):
        still = driver.execute_script(f"return !document.querySelector('#{figure} .still').hidden")
        pixels = pixels_of(driver, f"#{figure} {'.still' if still else '.scene'}")
        colours, counts = np.unique(pixels @ (1 << 16, 1 << 8, 1), return_counts=True)
        paper = colours[np.argmax(counts)] >> np.array([16, 8, 0]) & 255
        papers.append(paper.mean())
        ink = np.abs(pixels - paper).max(axis=2) > 60
        # Ink over a fair part of the picture, and in each half of it.
        assert 0.004 < ink.mean() < 0.6, figure
        half = ink.shape[1] // 2
        assert ink[:, :half].any(), figure
        assert ink[:, half:].any(), figure
    assert all(paper < 60 for paper in papers) if dark else all(paper > 240 for paper in papers)


def check_that_hostile_names_ran_nothing(driver: Any) -> None:
    from selenium.common.exceptions import NoAlertPresentException

    with pytest.raises(NoAlertPresentException):
        _ = driver.switch_to.alert.text
    assert HOSTILE in driver.find_element("css selector", "h1").text
    assert driver.find_elements("css selector", "img, frac") == []


def test_a_view_is_turned_by_the_keyboard(driver: Any, folder: Path) -> None:
    browser.look(driver, folder / "gated.html", browser.DESKTOP)
    browser.settled(driver)
    eye = "return document.querySelector('figure[data-starts=yes] .scene').layout.scene.camera.eye"
    before = driver.execute_script(eye)
    button = driver.find_element("css selector", "figure[data-starts=yes] button[data-move=left]")
    assert button.get_attribute("aria-label") == "Turn left"
    button.send_keys("\n")
    after = driver.execute_script(eye)
    assert np.hypot(after["x"], after["y"]) == pytest.approx(np.hypot(before["x"], before["y"]))
    assert abs(after["x"] - before["x"]) > 0.1
    switch = driver.find_element("css selector", "figure[data-starts=yes] .switch")
    switch.send_keys("\n")
    assert driver.find_element("css selector", "figure[data-starts=yes] .still svg").is_displayed()
    assert switch.get_attribute("aria-pressed") == "false"


def test_a_bright_page_has_ink_and_a_pose_pointed_at_says_its_row(driver: Any, folder: Path) -> None:
    browser.look(driver, folder / "hostile.html", browser.DESKTOP)
    browser.settled(driver)
    check_that_charts_have_ink(driver, dark=False)
    texts = driver.execute_script(
        "return document.querySelector('figure[data-starts=yes] .scene').data.find(t => t.text).text"
    )
    document = hostile(results.document("trace"))
    assert len(texts) == document["n_poses"]
    line, pose = document["poses"]["line"][7], html.escape(document["poses"]["pose"][7], quote=False)
    after = np.linalg.norm(document["poses"]["errors_m"]["held_out_after"][7]) * 1e3
    assert texts[7].startswith(f"line {line}, pose {pose}<br>baseline:")
    assert float(texts[7].rpartition("extended model: ")[2].split()[0]) == pytest.approx(after, rel=6e-3)


@pytest.mark.parametrize("name", PAGES)
def test_a_page_on_a_desk_is_drawn_whole_and_printed_on_a4(name: str, driver: Any, folder: Path) -> None:
    from pypdf import PdfReader

    page_file = folder / f"{name}.html"
    browser.look(driver, page_file, browser.DESKTOP, "dark")
    browser.settled(driver)
    check_that_all_is_drawn_and_nothing_asked_for(driver, page_file, browser.DESKTOP[0])
    if name == "hostile":
        check_that_hostile_names_ran_nothing(driver)
        check_that_charts_have_ink(driver, dark=True)
    pdf = PdfReader(io.BytesIO(browser.printed(driver)))
    limit = 14 if name in ("several", "hostile") else 9
    assert 2 <= len(pdf.pages) <= limit
    for page in pdf.pages:
        assert (float(page.mediabox.width), float(page.mediabox.height)) == pytest.approx((595, 842), abs=2)
    text = "\n".join(page.extract_text() for page in pdf.pages)
    for wanted in ("Charts", "How to reproduce this result", "SHA-256", "Signatures", "Released by"):
        assert wanted in text
    for record in results.document("trace")["inputs"] if name == "several" else ():
        assert record["sha256"] in text.replace("\n", "")
    assert "Show in 3-D" not in text
    # Nothing of a page stands beside the paper: laid out for paper, the page is no wider than it.
    metrics = {"width": 700, "height": 990, "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    wide = driver.execute_script("return document.documentElement.scrollWidth")
    paper = driver.execute_script("return getComputedStyle(document.body).backgroundColor")
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "screen"})
    assert wide <= 700
    assert paper == "rgb(255, 255, 255)"
