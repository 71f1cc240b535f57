"""The report in a real browser: it draws, without an error and without a request, and nothing lies over another.

Screenshots stay in test-artifacts/.
"""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import carm_kin
from carm_kin.report import write_report, write_summary
from helpers.browser import ARTIFACTS, chromium, opened
from helpers.places import DATA

REAL = DATA / "real-carm" / "marker_two_placements.csv"
BLUE, TEAL = (29, 111, 216), (13, 148, 136)
"""The first orbital sweep, and the lines of the torus surface."""

OVERLAPS = """() => {  // the boxes of slanted texts overlap where their letters do not
  const found = [];
  for (const plot of document.querySelectorAll("figure.flat .plot")) {
    const slanted = (it) => /rotate\\(-?(?!0|90|180)\\d/.test(it.getAttribute("transform") || "");
    const texts = [...plot.querySelectorAll("text")].filter((it) => it.textContent.trim() && !slanted(it));
    const boxes = texts.map((it) => [it.textContent, it.getBoundingClientRect()]);
    const frame = plot.getBoundingClientRect();
    boxes.forEach(([a, p], i) => {
      const out = p.left < frame.left - 2 || p.right > frame.right + 2 || p.bottom > frame.bottom + 2;
      if (out) found.push(`${a} sticks out`);
      for (const [b, q] of boxes.slice(i + 1)) {
        const wide = Math.min(p.right, q.right) - Math.max(p.left, q.left);
        const high = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
        if (wide > 2 && high > 2) found.push(`${a} over ${b}`);
      }
    });
  }
  return found;
}"""
WIDTHS = "() => [document.documentElement.scrollWidth, innerWidth]"


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    """The demo's recording with outliers and labels that try to run."""
    noise = {"sigma_t_m": 3e-4, "sigma_r_rad": 1e-3}
    recording, truth = carm_kin.simulate("mobile_nonisocentric", "clinical", **noise, outliers=0.02, seed=0)
    label = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
    recording = replace(recording, sweep=np.array([label + sweep for sweep in recording.sweep]))
    results = {name: carm_kin.calibrate(recording, name) for name in ("kinematic", "closed_form", "direct")}
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(results["kinematic"], recording, path, compared=results, truth=truth)
    return path


def near(image: np.ndarray, colour: tuple[int, int, int], within: int = 40) -> int:
    """How many pixels have about this colour."""
    return int((np.abs(image[..., :3].astype(int) - colour).max(axis=-1) < within).sum())


def pixels(png: bytes) -> np.ndarray:
    image = pytest.importorskip("PIL.Image", reason="pillow is not here; pip install 'carm-kin[test]'")
    return np.asarray(image.open(io.BytesIO(png)).convert("RGB"))


def check(found, shot: str) -> None:
    """What holds of every page; its picture is kept."""
    ARTIFACTS.mkdir(exist_ok=True)
    found.page.screenshot(path=ARTIFACTS / f"{shot}.png", full_page=True)
    assert found.errors == []
    assert found.requests == []
    wide, window = found.page.evaluate(WIDTHS)
    assert wide <= window
    assert found.page.evaluate(OVERLAPS) == []


def test_it_draws_hides_and_prints(browser, page):
    with opened(browser, page, "light") as found:
        check(found, "report-light")
        assert found.page.locator("figure.flat .plot .main-svg").count() > 6
        assert found.page.locator("img[src=x]").count() == 0
        _hides_the_surface(found.page)
        _prints(found.page)
        assert found.errors == []
        assert found.requests == []


def _hides_the_surface(page) -> None:
    plot = page.locator("figure.space .plot")
    with_surface = pixels(plot.screenshot())
    assert near(with_surface, BLUE) > 300
    assert near(with_surface, TEAL) > 300
    key = page.locator("figure.space .key", has_text="torus surface")
    key.click()
    page.wait_for_timeout(500)
    without = pixels(plot.screenshot())
    assert key.get_attribute("aria-pressed") == "false"
    assert near(without, TEAL) < near(with_surface, TEAL) / 10
    assert near(without, BLUE) > 300


def _prints(page) -> None:
    """The picture stands in for the view in space, and is no blank one."""
    pdf = page.pdf(format="A4", print_background=True)
    assert pdf.startswith(b"%PDF")
    (ARTIFACTS / "report.pdf").write_bytes(pdf)
    page.emulate_media(media="print")
    picture = page.locator("figure.space .paper")
    assert picture.is_visible()
    assert not page.locator("figure.space .plot").is_visible()
    drawn = pixels(picture.screenshot())
    assert (drawn.min(axis=2) < 200).mean() > 0.02


def test_it_fits_a_phone(browser, page):
    with opened(browser, page, "phone") as found:
        check(found, "report-phone")


def test_it_follows_the_colours_of_the_system(browser, page):
    with opened(browser, page, "dark") as found:
        found.page.locator("figure.space .plot").scroll_into_view_if_needed()
        ink = "() => getComputedStyle(document.querySelector('.flat .xtick text')).fill"
        dark = found.page.evaluate(ink), pixels(found.page.screenshot()).mean()
        assert found.errors == []
        found.page.emulate_media(color_scheme="light")
        found.page.wait_for_timeout(1500)
        light = found.page.evaluate(ink), pixels(found.page.screenshot()).mean()
        assert dark[0] != light[0]
        assert dark[1] < 60 < 200 < light[1]
        assert near(pixels(found.page.locator("figure.space .plot").screenshot()), BLUE) > 300
        assert found.errors == []


@pytest.mark.skipif(not REAL.is_file(), reason="../shared/data/real-carm is not here")
def test_a_real_recording(browser, tmp_path):
    recording = carm_kin.read_recording(REAL)
    write_report(carm_kin.calibrate(recording), recording, tmp_path / "report.html")
    with opened(browser, tmp_path / "report.html", "phone") as found:
        check(found, "real-phone")
        assert near(pixels(found.page.locator("figure.space .plot").screenshot()), TEAL) > 100


def test_a_summary(browser, tmp_path):
    results = {
        f"a recording with a long name {seed}.csv": carm_kin.calibrate(
            carm_kin.simulate("mobile_skewed", "minimal", sigma_t_m=1e-3, sigma_r_rad=1e-3, seed=seed)[0]
        )
        for seed in range(4)
    }
    write_summary(results, tmp_path / "summary.html", title="Four calibrations")
    with opened(browser, tmp_path / "summary.html", "phone") as found:
        check(found, "summary-phone")


def test_without_webgl_it_says_so_and_draws_the_rest(page, browser):
    """In a tab that refuses every WebGL context."""
    refuse = "HTMLCanvasElement.prototype.getContext = ((own) => function (kind, ...more) {"
    refuse += " return kind.includes('webgl') ? null : own.call(this, kind, ...more); })"
    refuse += "(HTMLCanvasElement.prototype.getContext);"
    with opened(browser, page, "light", refuse) as found:
        assert "WebGL" in found.page.locator("figure.space .plot").inner_text()
        assert found.page.locator("figure.flat .plot .main-svg").count() > 6
        assert found.errors == []
