"""The report: it draws what was recorded, says what the result says, and nothing in it runs or calls."""

import getpass
import json
import re
import socket
import sys
import time
from dataclasses import replace
from pathlib import Path

import lxml.etree as etree
import lxml.html
import numpy as np
import plotly.graph_objects as go
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import carm_kin
from carm_kin.calibration.chain.calibrate import FreeJoints, calibrate_chain
from carm_kin.errors import InputError, MissingDependencyError
from carm_kin.recording.recording import Recording, Source
from carm_kin.report import Joints, together, write_figures, write_report, write_summary
from carm_kin.report.charts import charts
from carm_kin.report.circle import cut, span
from carm_kin.report.comparison import comparison_of
from carm_kin.report.isocentre import wander_of
from carm_kin.report.marks import Axis, Bars, Chart, Line, Panel, Points, Surface, keys
from carm_kin.report.matplotlib_figures import draw
from carm_kin.report.page import embedded
from carm_kin.report.plotly_figures import plain, plotly_figure
from carm_kin.report.poses import poses_of
from carm_kin.report.scene import scene
from carm_kin.report.words import number, with_sigma
from carm_kin.results.result import CalibrationResult
from helpers import bending, simulated
from helpers.command import fails, run

HOSTILE = (
    "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
    '<a href="javascript:alert(3)">x</a>&amp;{{7*7}}\u2028'
)
NAMES = ("scene", "coverage", "residuals_alpha", "residuals_beta", "residuals_pose")
PLOTLY = re.compile(r"<script>.*?</script>", re.DOTALL)


@pytest.fixture(scope="module")
def recording() -> Recording:
    found, _ = carm_kin.simulate(
        "mobile_skewed", "clinical", sigma_t_m=3e-4, sigma_r_rad=1e-3, outliers=0.03, missing=0.05, seed=11
    )
    return found.select(slice(None, None, 3))


@pytest.fixture(scope="module")
def result(recording) -> CalibrationResult:
    return carm_kin.calibrate(recording)


@pytest.fixture(scope="module")
def refused(recording) -> tuple[CalibrationResult, Recording]:
    one = recording.select(recording.sweep == recording.sweeps[0].label)
    return carm_kin.calibrate(one), one


@pytest.fixture(scope="module")
def hostile(recording) -> tuple[CalibrationResult, Recording]:
    """Every text of a recording that a user or a file can choose."""
    labels = np.array([HOSTILE + label for label in recording.sweep])
    named = replace(
        recording,
        sweep=labels,
        placement=np.where(np.arange(len(recording)) < 0, "", HOSTILE),
        source=Source(f"/home/someone/{HOSTILE}.csv", HOSTILE),
    )
    return carm_kin.calibrate(named, command=HOSTILE), named


def page_of(path: Path) -> lxml.html.HtmlElement:
    return lxml.html.fromstring(path.read_text(encoding="utf-8"))


def own_text(path: Path) -> str:
    """The page without plotly.js."""
    text = path.read_text(encoding="utf-8")
    longest = max(PLOTLY.findall(text), key=len)
    assert len(longest) > 1e6
    return text.replace(longest, "")


def contents(path: Path) -> list[dict]:
    return [json.loads(script.text) for script in page_of(path).iter("script") if script.get("type")]


# what is drawn


@given(st.lists(st.floats(-20, 20), min_size=1, max_size=12))
def test_a_span_is_the_shortest_arc_with_all_angles(values):
    angle = np.array(values)
    low, high = span(angle)
    turned = cut(angle, low, high)
    np.testing.assert_allclose(np.exp(1j * turned), np.exp(1j * angle), atol=1e-9)
    assert (turned >= low - 1e-6).all()
    assert (turned <= high + 1e-6).all()
    starts = ((angle[:, None] - angle) % (2 * np.pi)).max(axis=0)
    if starts.min() < np.radians(329):
        assert high - low == pytest.approx(starts.min(), abs=1e-6)


def test_residuals_are_told_by_direction():
    """A pose that is shifted along the orbital axis, in a sweep whose labelled alpha and free beta cannot follow."""
    truth, motion = simulated.machine(2, R=0.08, epsilon=0.01), simulated.small()
    p, R = truth.poses(motion.angles)
    p[3] += 2e-3 * R[3] @ truth.a
    R[5] = Rotation.from_rotvec(0.003 * truth.n[0]).as_matrix() @ R[5]
    labels = motion.held.max(axis=1)
    recording = Recording(
        p,
        R,
        sweep=labels.astype(str),
        moving=np.where(motion.held[:, 0] >= 0, "orbital", "angular"),
        joints={"angular": motion.label[:, 0], "orbital": motion.label[:, 1]},
    )
    result = carm_kin.calibrate(recording, sigma_t_m=2e-5, sigma_r_rad=2e-5)
    assert set(result.outliers.indices) == {3, 5}
    fit = poses_of(result, recording).fit
    assert fit is not None
    np.testing.assert_allclose(fit.residual[3], [0, 2e-3, 0, 0, 0, 0], atol=2e-5)
    assert fit.residual[5, 3] == pytest.approx(0.003, abs=3e-5)
    np.testing.assert_allclose(fit.residual[np.delete(np.arange(60), (3, 5))], 0, atol=1e-6)
    shift = np.angle(np.exp(1j * (fit.angles - motion.angles)))
    np.testing.assert_allclose(np.delete(shift, (3, 5), axis=0), 0, atol=1e-5)


@pytest.mark.parametrize("labels", [True, False])
def test_the_expected_residuals_are_those_of_many_recordings(labels):
    """Their mean squares over 60 seeds, component by component: 3600 squares each have a deviation of some 2.5% where
    nothing is absorbed; 15% is 6 of them, and is kept where the angles absorb most."""
    truth, motion = simulated.machine(4, R=0.1), simulated.small()
    motion = motion if labels else motion.free()
    squares, expected = np.zeros((60, 6)), np.zeros((60, 6))
    for seed in range(60):
        drawn = simulated.problem(truth, motion, 5e-4, 1e-3, seed)
        joints = {name: motion.label[:, k] for k, name in enumerate(("angular", "orbital"))}
        sweep = motion.held.max(axis=1)
        moving = np.where(motion.held[:, 0] >= 0, "orbital", np.where(sweep >= 0, "angular", ""))
        recording = Recording(
            drawn.p_world_sensor,
            drawn.R_world_sensor,
            sweep=np.where(sweep >= 0, sweep.astype(str), ""),
            moving=moving,
            joints=joints if labels else {},
        )
        noise = {"sigma_t_m": 5e-4, "sigma_r_rad": 1e-3}
        result = carm_kin.calibrate(recording, reject_outliers=False, systematic="none", **noise)
        fit = poses_of(result, recording).fit
        assert fit is not None
        squares += fit.residual**2
        expected += fit.expected**2
    ratio = squares.sum(axis=0) / expected.sum(axis=0)
    np.testing.assert_allclose(ratio, 1, atol=0.15)
    weight = np.repeat([5e-4, 1e-3], 3) ** -2.0
    assert (squares * weight).sum() / (expected * weight).sum() == pytest.approx(1, abs=0.03)


def test_the_scene_is_to_scale(recording, result):
    """In the frame of the torus the fitted surface passes through the used poses, and the circle has the radius R."""
    it = scene(result, poses_of(result, recording))
    dots = np.concatenate([m.at for m in it.marks if isinstance(m, Points) and m.name.startswith("poses")])
    T = result.placements[0].T_world_torus
    used = ~np.isin(recording.pose_number, result.outliers.indices)
    expected = (recording.p_world_sensor[used] - T[:3, 3]) @ T[:3, :3] * 1e3
    assert len(dots) == used.sum()
    np.testing.assert_allclose(np.sort(dots, axis=0), np.sort(expected, axis=0), atol=1e-6)
    (circle,) = (m.at for m in it.marks if isinstance(m, Line) and m.name == "circle of the rotation centre")
    np.testing.assert_allclose(np.linalg.norm(circle, axis=1), result.major_radius_m * 1e3)
    (surface,) = (m.at for m in it.marks if isinstance(m, Surface) and m.name == "torus surface")
    nearest = [np.linalg.norm(surface.reshape(-1, 3) - dot, axis=1).min() for dot in dots[::20]]
    assert max(nearest) < 60
    layout = plotly_figure(it)["layout"]["scene"]
    assert layout["aspectmode"] == "data"


def test_the_ellipsoid_is_the_covariance(recording, result):
    """Every point of it lies at the 95% distance from the rotation centre, in the drawn sensor's frame."""
    it = scene(result, poses_of(result, recording))
    (ball,) = (m.at.reshape(-1, 3) for m in it.marks if isinstance(m, Surface) and "uncertainty" in m.name)
    (centre,) = (m.at for m in it.marks if isinstance(m, Points) and m.name == "rotation centre")
    arms = [m.at[6:8] for m in it.marks if isinstance(m, Line) and m.name.endswith("of the frames")]
    R_torus_sensor = np.stack([(arm[1] - arm[0]) / np.linalg.norm(arm[1] - arm[0]) for arm in arms], axis=1)
    times = float(re.search(r"enlarged ([\d.e+]+) times", it.caption)[1])
    off_m = (ball - centre) @ R_torus_sensor / times / 1e3
    C = result.covariance.block("offset_sensor_pivot")
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", off_m, np.linalg.inv(C), off_m), 7.8147, rtol=1e-4)


def test_histograms_hold_all_residuals(recording, result):
    poses = poses_of(result, recording)
    for chart in charts(result, poses)[-2:]:
        (bars,) = (mark for mark in chart.marks if isinstance(mark, Bars))
        (curve,) = (mark.at for mark in chart.marks if isinstance(mark, Line))
        assert (bars.heights * np.diff(bars.edges)).sum() == pytest.approx(1)
        assert np.trapezoid(curve[:, 1], curve[:, 0]) == pytest.approx(1, abs=0.02)


def test_long_recordings_are_thinned_with_the_worst_poses_kept():
    long, _ = carm_kin.simulate("mobile_nonisocentric", "paper", sigma_t_m=1e-3, sigma_r_rad=2e-3, seed=1)
    result = carm_kin.calibrate(long)
    poses = poses_of(result, long)
    assert poses.fit is not None
    size = np.linalg.norm(poses.fit.residual[:, :3], axis=1) * poses.used
    assert poses.sampled[np.argsort(size)[-20:]].all()
    assert poses.shown.sum() < 2500
    assert poses.sampled.sum() < 1000
    assert "of 10080 poses are drawn" in charts(result, poses)[1].caption


@pytest.mark.parametrize("case", ["ok", "refused", "surface", "hostile"])
def test_plotly_accepts_every_figure(case, recording, result, refused, hostile):
    pairs = {"ok": (result, recording), "refused": refused, "hostile": hostile}
    of, poses = pairs.get(case) or (carm_kin.calibrate(recording, "surface"), recording)
    looked = poses_of(of, poses)
    for figure in (scene(of, looked), *charts(of, looked), *comparison_of({HOSTILE: of, "b": of}).charts):
        content = plotly_figure(figure)
        assert len(go.Figure(content).data) == len(figure.marks)
        members = [k for key in keys(figure) for k in key.members]
        assert len(set(members)) == len(members)


# what the page says


def test_the_page_has_the_numbers_with_their_sigmas(recording, result, tmp_path):
    write_report(result, recording, tmp_path / "report.html")
    text = re.sub(r"\s+", " ", page_of(tmp_path / "report.html").find(".//main").text_content())
    for value, sigma in zip(result.offset_sensor_pivot_m * 1e3, result.sigma.offset_sensor_pivot_m * 1e3, strict=True):
        found = re.search(rf"({re.escape(f'{value:.3f}')}) ?± ([\d.]+)", text)
        assert found, value
        assert float(found[2]) == pytest.approx(sigma, rel=0.06)
    assert f"{result.used} of {result.poses} poses" in text
    assert all(note.message in text for note in result.warnings)
    assert str(result.outliers.indices[0]) in text
    assert text.index("Offset") < text.index("The machine and the poses") < text.index("Provenance")


def test_the_isocentre_has_its_maps_where_the_c_bends(recording, result, tmp_path):
    """A map's colours are those of the sag that was put in, which is known in closed form."""
    bent = replace(result, deformation=bending.deformation())
    write_report(replace(result, deformation=None), recording, tmp_path / "rigid.html")
    assert "Isocentre" not in own_text(tmp_path / "rigid.html")
    write_report(bent, recording, tmp_path / "bent.html")
    page = page_of(tmp_path / "bent.html")
    (section,) = [one for one in page.iter("section") if one.findtext("h2") == "Isocentre: the C bends"]
    assert "over the angular axis from -60 to 60 deg it walks" in section.text_content().lower()
    drawn = wander_of(bent).charts
    assert [f"figure-{chart.name}" for chart in drawn] == [figure.get("id") for figure in section.iter("figure")]
    at = drawn[0].panels[0].marks[0]
    angles = np.radians(np.stack(np.meshgrid(at.x, at.y, indexing="ij"), axis=-1).reshape(-1, 2))
    expected = bending.shift_m(angles).reshape(*at.values.shape, 3) * 1e3
    np.testing.assert_allclose(at.values, np.linalg.norm(expected, axis=2), atol=0.03)
    for chart, k in zip(drawn[1:], range(3), strict=True):
        np.testing.assert_allclose(chart.panels[0].marks[0].values, expected[..., k], atol=0.03)
    trace = plotly_figure(drawn[2])["data"][0]
    assert trace["z"][5][40] == pytest.approx(expected[40, 5, 1], abs=0.03)
    go.Figure(plotly_figure(drawn[0]))
    draw(drawn[0], [tmp_path / "map.png"])
    assert (tmp_path / "map.png").stat().st_size > 10_000


def test_the_page_of_a_refusal_says_why_and_has_no_number(refused, tmp_path):
    result, recording = refused
    write_report(result, recording, tmp_path / "report.html")
    text = page_of(tmp_path / "report.html").find(".//main").text_content()
    assert result.refusal.message in text
    assert result.refusal.code in text
    assert "rotation centre in the sensor" not in text
    assert "The recorded positions" in text


@pytest.mark.parametrize("solver", ["surface", "closed_form", "direct", "decomposed"])
def test_every_solver_has_a_page(solver, recording, tmp_path):
    write_report(carm_kin.calibrate(recording, solver), recording, tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size > 1e6


def test_a_point_has_a_page(tmp_path):
    R = Rotation.random(40, random_state=6).as_matrix()
    pointer = Recording(np.array([0.3, 0.1, -0.9]) - R @ [0.01, -0.02, 0.15], R)
    write_report(carm_kin.calibrate(pointer, locus="point"), pointer, tmp_path / "report.html")
    text = page_of(tmp_path / "report.html").find(".//main").text_content()
    assert "10.000" in text
    assert "no complete chain" in text


def test_saved_and_read_again_the_page_is_the_same_but_for_the_angles(recording, result, tmp_path):
    result.to_json(tmp_path / "result.json")
    again = CalibrationResult.from_json(tmp_path / "result.json")
    one, other = (poses_of(r, recording).fit for r in (result, again))
    np.testing.assert_allclose(one.residual, other.residual, atol=2e-7)


def test_nothing_of_the_machine_or_its_user_is_in_the_page(hostile, tmp_path):
    write_report(*hostile, tmp_path / "report.html")
    text = own_text(tmp_path / "report.html")
    assert "someone" not in text
    assert str(Path.home()) not in text
    assert socket.gethostname() not in text
    if len(getpass.getuser()) > 4:
        assert getpass.getuser() not in text
    assert str(tmp_path) not in text


def test_nothing_in_the_page_points_outside(recording, result, tmp_path):
    write_report(result, recording, tmp_path / "report.html")
    assert not re.search(r"https?://|//cdn", own_text(tmp_path / "report.html"))
    root = page_of(tmp_path / "report.html")
    assert [element.get("src") for element in root.iter("script", "img", "iframe") if element.get("src")] == []
    assert [link.get("href") for link in root.iter("link")] == ["data:,"]
    policy = root.find(".//meta[@http-equiv='Content-Security-Policy']").get("content")
    assert policy.startswith("default-src 'none'")


@pytest.mark.parametrize("kind", ["report", "summary"])
def test_hostile_labels_are_text(kind, hostile, recording, result, tmp_path):
    path = tmp_path / "page.html"
    if kind == "report":
        write_report(*hostile, path, compared={HOSTILE: hostile[0], "b": result})
    else:
        write_summary({HOSTILE: hostile[0], "b": result}, path, title=HOSTILE, links={HOSTILE: "javascript:alert(4)"})
    root = page_of(path)
    scripts = list(root.iter("script"))
    assert len(scripts) == 2 + len(list(root.iter("figure")))
    assert all("alert(" not in (script.text or "")[:200] for script in scripts)
    assert list(root.iter("img")) == []
    assert [a.get("href") for a in root.iter("a")] == ([] if kind == "report" else ["javascript%3Aalert%284%29"])
    assert not any(name.startswith("on") for element in root.iter() for name in element.attrib)
    assert "<script>alert(1)" in root.find(".//main").text_content()
    assert "49" not in root.find(".//header").text_content()
    texts = json.dumps(contents(path))
    assert "</script" not in texts
    assert "<a href" not in texts
    if kind == "report":
        assert "&lt;script" in texts


@given(st.text())
def test_embedded_json_cannot_end_its_script(text):
    written = str(embedded({"a": text}))
    assert not set(written) & set("<>&\u2028\u2029")
    assert json.loads(written) == {"a": text}


@given(st.text(alphabet="<>&;ab#lt/", max_size=20))
def test_plain_text_has_no_markup(text):
    shown = plain(text)
    assert not set(shown) & set("<>")
    assert lxml.html.fromstring(f"<p>{shown}</p>").text_content() == text


def test_ten_thousand_poses_are_quick_and_small(tmp_path):
    long, _ = carm_kin.simulate("mobile_nonisocentric", "paper", sigma_t_m=1e-3, sigma_r_rad=2e-3, outliers=0.1, seed=2)
    result = carm_kin.calibrate(long)
    start = time.process_time()
    write_report(result, long, tmp_path / "report.html")
    assert time.process_time() - start < 5
    assert (tmp_path / "report.html").stat().st_size < 8e6


def test_the_page_of_a_chain_has_the_changes_of_the_urdf(tmp_path):
    whole, _ = carm_kin.simulate("mobile_skewed", "minimal", sigma_t_m=1e-4, sigma_r_rad=1e-4, seed=4)
    found = calibrate_chain(whole.select(slice(None, None, 20)), "mobile_skewed", free=FreeJoints(("axes",)))
    write_report(found, whole.select(slice(None, None, 20)), tmp_path / "report.html")
    text = page_of(tmp_path / "report.html").find(".//main").text_content()
    assert "Changes of the URDF mobile_skewed.urdf" in text
    assert "Residuals against" in text


def test_a_page_that_cannot_be_written_is_an_input_error(recording, result, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_report(result, recording, tmp_path / "no" / "report.html")


def test_several_recordings_are_shown_together(recording, result):
    both = together([recording, recording])
    assert len(both) == 2 * len(recording)
    assert both.placements == ("recording 1", "recording 2")
    assert len(set(both.pose_number)) == len(both)
    assert together([recording]) is recording


# comparison and summary


def test_a_comparison_with_the_truth(recording, result):
    closed = carm_kin.calibrate(recording, "closed_form")
    truth = replace(result, offset_sensor_pivot_m=result.offset_sensor_pivot_m + np.array([3e-3, 0, -4e-3]))
    it = comparison_of({"a": result, "b": closed}, truth)
    assert it.lines[0].cells[-1].value == "5.0"
    assert it.lines[1].cells[0].sigma == ""
    (chart,) = it.charts
    points = {mark.name: mark for mark in chart.marks if isinstance(mark, Points)}
    np.testing.assert_allclose([points[axis].at[0, 1] for axis in "xyz"], [-3, 0, 4], atol=1e-9)
    np.testing.assert_allclose(points["x"].sigma, [result.sigma.offset_sensor_pivot_m[0] * 1e3, np.nan])


def test_a_comparison_of_refusals_only(refused):
    it = comparison_of({"a": refused[0]})
    assert refused[0].refusal.message in it.lines[0].refused
    assert it.charts == ()


def test_a_summary_counts_and_links(result, refused, tmp_path):
    results = {"one.csv": result, "two.csv": replace(result), "three.csv": refused[0]}
    write_summary(results, tmp_path / "summary.html", title="A folder", links={"one.csv": "one #1.html"})
    root = page_of(tmp_path / "summary.html")
    text = root.find(".//main").text_content()
    assert "2 of 3" in text
    assert refused[0].refusal.message in text
    assert [a.get("href") for a in root.iter("a")] == ["one%20%231.html"]
    assert len(list(root.iter("figure"))) == 2


def test_a_summary_of_many_is_thinned_but_for_the_table(result, tmp_path):
    write_summary({f"{k}.csv": result for k in range(1201)}, tmp_path / "summary.html")
    text = page_of(tmp_path / "summary.html").find(".//main").text_content()
    assert "401 of 1201 are drawn" in text
    assert "1200.csv" in text
    assert len(contents(tmp_path / "summary.html")[1]["data"][0]["x"]) == 401


def test_a_summary_of_nothing(tmp_path):
    write_summary({}, tmp_path / "summary.html")
    assert "0 of 0" in page_of(tmp_path / "summary.html").find(".//main").text_content()


# static figures


def test_static_figures_take_hostile_text_as_it_is(tmp_path):
    pytest.importorskip("matplotlib", reason="pip install 'carm-kin[figures]'")
    axis = Axis("x", (-1, 2), ("$\\frac{$", "_a^b$"))
    panel = Panel(axis, Axis("y"), (Points("$x^{$", np.zeros((2, 2)), "#000000"),))
    draw(Chart("a", "", "", (panel,)), [tmp_path / "a.svg"])
    assert (tmp_path / "a.svg").is_file()


def test_the_same_figure_has_the_same_bytes(recording, result, tmp_path):
    pytest.importorskip("matplotlib", reason="pip install 'carm-kin[figures]'")
    chart = charts(result, poses_of(result, recording))[0]
    for name in ("a.svg", "b.svg"):
        draw(chart, [tmp_path / name])
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_without_matplotlib_it_says_how_to_get_it(recording, result, tmp_path, monkeypatch):
    for module in ("matplotlib", "matplotlib.figure"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingDependencyError, match=r"carm-kin\[figures\]"):
        write_figures(result, recording, tmp_path)


# numbers


@pytest.mark.parametrize(
    "value, sigma, expected",
    [
        (130.07690, 0.0362, ("130.077", "0.036")),
        (-14.6, 0.66, ("-14.60", "0.66")),
        (703.04, 12.3, ("703", "12")),
        (0.002, 0.0000213, ("0.002000", "0.000021")),
        (5.0, None, ("5.000", "")),
        (5.0, 0.0, ("5.000", "")),
        (5.0, float("nan"), ("5.000", "")),
        (5.0, float("inf"), ("5.000", "")),
    ],
)
def test_a_number_has_the_digits_of_its_sigma(value, sigma, expected):
    assert with_sigma(value, sigma) == expected


@pytest.mark.parametrize("value, expected", [(0.0541, "0.054"), (12.6, "13"), (0.0, "0"), (3.2e-9, "3.2e-09")])
def test_a_number_alone_has_two_digits(value, expected):
    assert number(value) == expected


# the command


@pytest.fixture(scope="module")
def rec(recording, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("rec") / "rec.csv"
    carm_kin.write_recording(recording, path)
    return path


def test_calibrate_writes_the_page_and_every_figure_as_svg_and_png(rec, tmp_path, capsys):
    image_of = pytest.importorskip("matplotlib.image", reason="pip install 'carm-kin[figures]'")
    page, figures = tmp_path / "report.html", tmp_path / "figures"
    ended = run(capsys, "calibrate", rec, "--report", page, "--figures", figures)
    assert ended.status == 0
    assert {f"written: {file}" for file in (page, *figures.iterdir())} <= set(ended.err.splitlines())
    assert "rec.csv" in page_of(page).findtext(".//title")
    names = [*NAMES, "histogram_position", "histogram_rotation"]
    assert {path.name for path in figures.iterdir()} == {f"{name}{end}" for name in names for end in (".svg", ".png")}
    for path in figures.glob("*.svg"):
        assert etree.parse(str(path)).getroot().tag.endswith("svg")
    for path in figures.glob("*.png"):
        pixels = (image_of.imread(path)[::7, ::7, :3] * 255).astype(int).reshape(-1, 3)
        assert len(np.unique(pixels, axis=0)) > 10


def test_a_refusal_has_a_page_too(refused, tmp_path, capsys):
    carm_kin.write_recording(refused[1], tmp_path / "rec.csv")
    ended = run(capsys, "calibrate", tmp_path / "rec.csv", "--report", tmp_path / "report.html")
    assert ended.status == 3
    assert "one_axis_only" in (tmp_path / "report.html").read_text()


def test_the_demo_has_a_page(tmp_path, capsys):
    ended = run(capsys, "demo", "--out", tmp_path / "demo", "--report", tmp_path / "report.html")
    assert ended.status == 0
    text = page_of(tmp_path / "report.html").find(".//main").text_content()
    assert "Comparison of the solvers" in text
    assert "distance of the offset from the truth" in text


@pytest.mark.parametrize("option, words", [("--report", "does not exist"), ("--figures", "is a file")])
def test_a_bad_place_is_told_before_the_work(option, words, rec, tmp_path, capsys):
    place = tmp_path / "no" / "report.html" if option == "--report" else rec
    assert words in fails(capsys, "calibrate", tmp_path / "missing.csv", option, place)


def test_joints_may_have_names_of_their_own(recording, tmp_path):
    renamed = replace(
        recording,
        moving=np.char.replace(recording.moving.astype(str), "orbital", "slide"),
        joints={{"orbital": "slide"}.get(name, name): values for name, values in recording.joints.items()},
    )
    result = carm_kin.calibrate(renamed, orbital="slide")
    poses = poses_of(result, renamed, Joints(orbital="slide"))
    assert poses.fit is not None
    assert [group.name for group in poses.groups] == ["poses of angular sweeps", "poses of orbital sweeps"]
