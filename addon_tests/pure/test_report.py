"""Is the report whole, safe and true to the results, whatever of them is undefined?"""

import base64
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xihe_blender.report.page as report
from addon_tests.pure import runs
from xihe_blender.errors import UserError
from xihe_blender.io.json_records import from_json
from xihe_blender.io.outputs import RunOutputs, write_json
from xihe_blender.io.run_results import RunResults, read_results
from xihe_blender.report import pictures
from xihe_blender.report.pictures import MAX_FRAMES
from xihenet.formats import format_number, format_runs
from xihenet.io.png import write_png

VOID = {"meta", "img", "input", "wbr"}
METHODS = ("projection", "ambient", "truth")
KINDS = ("captured", "ground_truth", *METHODS, "error_projection", "error_ambient")
NASTY_NAME = "Vase <script>alert(1)</script> & \"copper\" 'pot' \N{POTTED PLANT}"


# ------------------------------------------------------------------------------------------- synthetic results


def one_picture(kind: str, number: int, size: tuple[int, int]) -> np.ndarray:
    """Different for each kind and frame."""
    width, height = size
    return np.random.default_rng([KINDS.index(kind), number]).integers(0, 256, (height, width, 3), np.uint8)


def one_probe(rng: np.random.Generator, name: str, step: int, *, fires: bool) -> dict[str, Any]:
    truth = 0.2 * rng.standard_normal((9, 3))
    estimate = truth + 0.08 * rng.standard_normal((9, 3)) / (1 + 0.1 * step)
    reason = ("first" if step == 0 else ("colour", "coverage")[step % 2]) if fires else "none"
    return runs.probe(
        name,
        coverage=1 - math.exp(-0.3 - 0.06 * step),
        fired=fires,
        reason=reason,
        change=None if step == 0 else 0.62 if reason == "colour" else float(0.3 * rng.random()),
        threshold=0.2 if reason == "coverage" else 0.6,
        payload_bytes=int(2000 + 150 * step + 400 * rng.random()) if fires else 0,
        sh=estimate.tolist(),
        sh_truth=truth.tolist(),
        shc_rmse=float(np.sqrt(np.mean((estimate - truth) ** 2))),
    )


def one_frame(rng: np.random.Generator, step: int, names: tuple[str, ...], *, fires: bool) -> dict[str, Any]:
    stage_ms = {"unproject": 1.9, "sample": 2.1, "merge": 0.1, "trigger": 0.3, "encode": 0.1, "estimate": 0.9}
    slow = 12.0 if step == 0 else 1.0
    probes = [one_probe(rng, name, step, fires=fires) for name in names]
    measured = {k: slow * v * float(1 + 0.2 * rng.random()) for k, v in stage_ms.items()}
    return runs.frame(step + 1, *probes, stage_ms=measured if names else {})


def add_comparison(frame: dict[str, Any], outputs: RunOutputs, size: tuple[int, int]) -> None:
    """Pictures on disk and metrics, as a compared frame has them."""
    paths = {kind: outputs.picture(kind, frame["frame"]) for kind in KINDS}
    for kind, path in paths.items():
        write_png(path, one_picture(kind, frame["frame"], size))
    frame |= runs.compared(KINDS, COMPARISON)
    frame["pictures"] = {kind: outputs.relative(path) for kind, path in paths.items()}


COMPARISON: dict[str, dict[str, float | None]] = {
    "projection": {"psnr": 31.4159, "ssim": 0.98123, "rmse": 0.03414, "si_rmse": 0.02001, "angular_deg": 1.25},
    "ambient": {"psnr": 27.1, "ssim": 0.9507, "rmse": 0.04931, "si_rmse": 0.0399, "angular_deg": 2.5},
    "truth": {"psnr": 38.25, "ssim": 0.9931, "rmse": 0.0152, "si_rmse": 0.0113, "angular_deg": 0.61},
}


def synthetic(
    folder: Path,
    *,
    n_frames: int = 24,
    names: tuple[str, ...] = ("Vase", "Grey sphere"),
    inactive: tuple[int, ...] = (),
    compare_every: int = 6,
    size: tuple[int, int] = (32, 24),
) -> tuple[dict[str, Any], RunOutputs]:
    """Results as a run leaves them, and their pictures in `folder`."""
    rng = np.random.default_rng(5)
    outputs = RunOutputs(folder, "living_room")
    (folder / "pictures").mkdir(parents=True, exist_ok=True)
    fired = {0, 3, 8, 15, 20}
    frames = [
        one_frame(rng, i, () if i in inactive else names, fires=i % 24 in fired and i < 48) for i in range(n_frames)
    ]
    for frame in frames:
        if frame["active"] and (frame["frame"] - 1) % compare_every == 0:
            add_comparison(frame, outputs, size)
    results = runs.content(
        frames,
        settings={"size": [256, 192], "frames": [frame["frame"] for frame in frames]},
        scene={"virtual_objects": names},
        effects=[{"name": "sensor_noise", "state": "on", "reason": "the camera path holds still for 4 frames"},
                 {"name": "motion_blur", "state": "off", "reason": "the camera moves less than a pixel per frame"}],
        comparison=COMPARISON if any("comparison" in frame for frame in frames) else {},
        summary={"n_estimates": sum(probe["fired"] for frame in frames for probe in frame["probes"]),
                 "mean_shc_rmse": 0.0712, "ambient_shc_rmse": 0.1466, "mean_step_ms": 5.3, "overhead_share": 0.021},
        notes=["Pictures are made with the Standard view transform, whatever the scene has set."],
    )  # fmt: skip
    return json.loads(json.dumps(results)), outputs


def page_of(results: dict[str, Any], outputs: RunOutputs) -> str:
    return report.write_report(from_json(RunResults, results), outputs).read_text(encoding="utf-8")


class Page(HTMLParser):
    """Reads a page, fails on a tag that is not closed or closed twice, and keeps what tests ask about."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(page)
        self.close()
        assert not self.open, f"never closed: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, f"</{tag}> closes something else"

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] not in ("script", "style"):
            self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words))

    def attributes(self, tag: str, name: str) -> list[str]:
        return [value for found, attrs in self.tags if found == tag and (value := attrs.get(name)) is not None]


# ------------------------------------------------------------------------------------------------- the whole page


@pytest.mark.parametrize(
    "made",
    [
        {},
        {"n_frames": 1},
        {"n_frames": 1, "inactive": (0,)},
        {"n_frames": 6, "inactive": tuple(range(6))},
        {"n_frames": 12, "inactive": (0, 4, 5, 11), "compare_every": 1},
        {"n_frames": 100, "names": tuple(f"Object {i}" for i in range(12)), "compare_every": 20, "size": (9, 16)},
    ],
)
def test_the_page_is_balanced_and_needs_nothing_from_outside(tmp_path, made):
    page = Page(page_of(*synthetic(tmp_path, **made)))
    sources = [source for tag in ("img", "script", "iframe") for source in page.attributes(tag, "src")]
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert all(target.startswith("#") for tag in ("a", "link", "use") for target in page.attributes(tag, "href"))
    whole = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"https?://|@import|url\(|file:", whole)
    ids = [attrs["id"] for _, attrs in page.tags if "id" in attrs]
    assert len(ids) == len(set(ids))
    assert not re.search(r"\b(None|nan|inf|NaN)\b", page.text)


def test_the_same_results_give_the_same_bytes(tmp_path):
    content, outputs = synthetic(tmp_path, n_frames=8)
    results = from_json(RunResults, content)
    first = report.write_report(results, outputs).read_bytes()
    assert report.write_report(results, outputs).read_bytes() == first
    assert results == from_json(RunResults, content)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["pictures", "report.html"]


def test_a_run_without_frames_still_makes_a_page(tmp_path):
    page = Page(page_of(runs.content(), RunOutputs(tmp_path, "room")))
    assert "Over no frames the phone made no estimates" in page.text
    assert "nothing to plot" in page.text and "This run made no pictures" in page.text


def test_what_is_undefined_is_a_dash_or_a_gap(tmp_path):
    results, outputs = synthetic(tmp_path, inactive=(3,))
    compared = [frame["comparison"] for frame in results["frames"] if "comparison" in frame]
    for comparison in (results["comparison"], *compared):
        comparison.update({method: runs.metrics() for method in METHODS})
    for probe in (probe for frame in results["frames"] for probe in frame["probes"]):
        probe |= {"change": None, "threshold": None}
    results["summary"] = runs.SUMMARY
    page = Page(page_of(results, outputs))
    assert not re.search(r"\b(None|nan|null)\b", page.text)
    assert "could not be measured against the ground truth" in page.text
    assert page.text.count("no value in any frame") == 1


@pytest.mark.parametrize(
    "wrong",
    [
        "{",
        "[]",
        {"schema_version": 2},
        {"settings": None},
        {"frames": [runs.frame(1, runs.probe(sh=None))]},
        {"frames": [runs.frame(1, runs.probe(coverage=math.nan))]},
        {"frames": [runs.frame(1, runs.probe(reason="boredom"))]},
        {"comparison": {"ambient": None}},
        {"software": {"command": ["xihe", "previs"]}},
    ],
)
def test_what_no_run_leaves_is_refused_when_it_is_read(tmp_path, wrong):
    file = tmp_path / "results.json"
    with pytest.raises(UserError, match="cannot be read"):
        read_results(tmp_path)
    write_json(file, runs.content())
    assert read_results(tmp_path) == runs.results()
    file.write_text(wrong if isinstance(wrong, str) else json.dumps(runs.content() | wrong))
    with pytest.raises(UserError, match="is not from a run of this version"):
        read_results(tmp_path)


def test_names_are_shown_as_text_and_never_become_markup(tmp_path):
    results, outputs = synthetic(tmp_path, n_frames=4, names=(NASTY_NAME,))
    results["scene"]["name"] = results["scene"]["file"] = results["notes"][0] = NASTY_NAME
    results["effects"][0] |= {"name": NASTY_NAME, "reason": NASTY_NAME, "parameters": {NASTY_NAME: NASTY_NAME}}
    results["phone"] = {"name": NASTY_NAME, "summary": NASTY_NAME}
    results["software"]["command"] = f"xihe previs {NASTY_NAME}"
    results["settings"] |= {"effect_choices": {NASTY_NAME: NASTY_NAME}, "preset": NASTY_NAME, "estimator": NASTY_NAME}
    results["comparison"][NASTY_NAME] = results["comparison"]["projection"]
    results["frames"][0]["pictures"][NASTY_NAME] = results["frames"][0]["pictures"]["projection"]
    whole = page_of(results, outputs)
    page = Page(whole)
    assert "<script>alert" not in whole
    assert sum(tag == "script" for tag, _ in page.tags) == 1
    assert page.text.count(NASTY_NAME) > 10
    assert NASTY_NAME in page.attributes("option", "value")


def test_a_name_that_is_no_text_does_not_cost_the_report(tmp_path):
    results, outputs = synthetic(tmp_path, n_frames=2, names=("broken \udcff name",))
    assert "broken ? name" in Page(page_of(results, outputs)).text


# ------------------------------------------------------------------------------------------------------- pictures


def test_embedded_pictures_are_the_files_byte_for_byte(tmp_path):
    results, outputs = synthetic(tmp_path, n_frames=8)
    page = Page(page_of(results, outputs))
    embedded = {base64.b64decode(src.partition(",")[2]) for src in page.attributes("img", "src")}
    shown = [frame for frame in results["frames"] if "comparison" in frame]
    assert shown and all((tmp_path / path).read_bytes() in embedded for f in shown for path in f["pictures"].values())
    assert set(page.attributes("img", "width")) == {"32"} and set(page.attributes("img", "height")) == {"24"}


@pytest.mark.parametrize("content", [None, b"", b"not a picture, but long enough to be one"])
def test_a_missing_or_broken_picture_is_named(tmp_path, content):
    results, outputs = synthetic(tmp_path, n_frames=2)
    lost = outputs.picture("ambient", 1)
    lost.unlink() if content is None else lost.write_bytes(content)
    page = Page(page_of(results, outputs))
    assert "No picture here. Expected pictures/ambient_0001.png" in page.text
    assert "ambient" not in page.attributes("img", "data-kind")


def test_a_file_outside_the_run_is_not_embedded(tmp_path):
    results, outputs = synthetic(tmp_path / "run", n_frames=1)
    write_png(tmp_path / "private.png", np.zeros((4, 4, 3), np.uint8))
    results["frames"][0]["pictures"]["truth"] = "../private.png"
    page = page_of(results, outputs)
    assert base64.b64encode((tmp_path / "private.png").read_bytes()).decode() not in page


def test_of_large_pictures_fewer_frames_are_embedded_and_one_at_least(tmp_path, monkeypatch):
    results, outputs = synthetic(tmp_path, n_frames=12, compare_every=1)
    whole = len(page_of(results, outputs))
    of_frame = max(sum((tmp_path / name).stat().st_size for name in f["pictures"].values()) for f in results["frames"])
    for most_bytes, n_shown in ((3 * of_frame, 3), (1, 1)):
        monkeypatch.setattr(pictures, "MAX_BYTES", most_bytes)
        page = page_of(results, outputs)
        assert len(Page(page).attributes("input", "data-frame")) == n_shown and len(page) < whole
        assert f"Pictures of {12 - n_shown} more frames are files beside this page" in Page(page).text


def test_frames_left_out_are_named_and_every_estimate_is_kept(tmp_path):
    results, outputs = synthetic(tmp_path, n_frames=60, compare_every=1)
    page = Page(page_of(results, outputs))
    shown = [int(frame) for frame in page.attributes("input", "data-frame")]
    fired = [f["frame"] for f in results["frames"] if any(p["fired"] for p in f["probes"])]
    assert len(shown) == MAX_FRAMES and shown == sorted(shown)
    assert set(fired) <= set(shown)
    assert f"Pictures of {60 - MAX_FRAMES} more frames are files beside this page" in page.text
    assert str(format_runs(sorted(set(range(1, 61)) - set(shown)))) in page.text


# --------------------------------------------------------------------------------------------------------- tables


def test_every_number_of_the_comparison_is_the_one_in_the_results(tmp_path):
    results, outputs = synthetic(tmp_path, n_frames=4)
    rng = np.random.default_rng(11)
    for metrics in results["comparison"].values():
        metrics.update({name: float(10 ** rng.uniform(-7, 3)) for name in metrics})
    whole = page_of(results, outputs)
    told = [float(value) for value in Page(whole).attributes("data", "value")]
    ordered = [results["comparison"][method] for method in ("projection", "ambient", "truth")]
    assert told == [metrics[name] for metrics in ordered for name in COMPARISON["truth"]]
    for value, shown in re.findall(r'<data value="([^"]+)">([^<]+)</data>', whole):
        assert float(shown.replace(",", "")) == pytest.approx(float(value), rel=6e-3, abs=6e-9)


def test_the_best_of_each_column_is_marked_and_truth_never_is(tmp_path):
    results, outputs = synthetic(tmp_path, n_frames=4)
    results["comparison"]["ambient"] |= {"ssim": 0.99, "angular_deg": 1.25}
    cells = dict(re.findall(r"<tr><th scope=\"row\"><code>(\w+)</code>(.*?)</tr>", page_of(results, outputs)))
    marked = {m: re.findall(r'data-column="(\w+)[^>]*><span><strong', cells[m]) for m in METHODS}
    assert marked["projection"] == ["psnr", "rmse", "si_rmse", "angular_deg"]
    assert marked["ambient"] == ["ssim", "angular_deg"]
    assert marked["truth"] == []


def test_an_undefined_metric_is_a_dash_with_its_reason(tmp_path):
    results, outputs = synthetic(tmp_path, n_frames=4)
    results["comparison"]["truth"]["psnr"] = None
    results["comparison"]["projection"]["angular_deg"] = None
    text = Page(page_of(results, outputs)).text
    assert "psnr of truth has no finite value for identical pictures" in text
    assert "angular_deg of projection is undefined where one of the colours is black" in text


def test_the_page_says_what_metrics_cannot_do_and_how_it_was_made(tmp_path):
    results, outputs = synthetic(tmp_path, n_frames=4)
    text = Page(page_of(results, outputs)).text
    assert "No image metric tracks human preference" in text
    assert results["software"]["command"] in text
    assert results["notes"][0] in text
    assert all(effect["reason"] in text for effect in results["effects"])


def test_the_table_of_effects_says_what_cycles_was_set_to(tmp_path):
    results, outputs = synthetic(tmp_path, n_frames=4)
    cycles = {"diffuse_bounces": 17, "use_light_tree": True, "use_fast_gi": False}
    phone = {"farthest_m": 5.0, "noise_at_1_m": 0.0019, "uplink_bit_per_s": 8e6, "link": "lte"}
    results["effects"][0]["parameters"] = cycles | phone
    text = Page(page_of(results, outputs)).text
    assert all(words in text for words in ("diffuse_bounces 17", "use_light_tree on", "use_fast_gi off", "link lte"))
    assert all(words in text for words in ("farthest_m 5", "noise_at_1_m 0.0019", "uplink_bit_per_s 8,000,000"))
    assert "farthest_m 5.0" not in text


def test_the_last_coefficients_of_a_probe_are_in_the_page(tmp_path):
    results, outputs = synthetic(tmp_path, n_frames=4, inactive=(3,))
    last = results["frames"][2]["probes"][0]
    text = Page(page_of(results, outputs)).text
    for triple in last["sh"] + last["sh_truth"]:
        assert all(f"{value:.4f}".replace("-", "\N{MINUS SIGN}") in text for value in triple)


def test_a_run_without_a_probe_in_view_says_so(tmp_path):
    results, outputs = synthetic(tmp_path, n_frames=6, inactive=tuple(range(6)))
    text = Page(page_of(results, outputs)).text
    assert "Over 6 frames the phone made no estimates: no position was in view." in text
    assert text.count("no position in view in any frame") == 5


# ------------------------------------------------------------------------------------------------- plots and numbers


def test_hovering_a_frame_tells_each_probes_value(tmp_path):
    results, outputs = synthetic(tmp_path, n_frames=5, inactive=(2,))
    whole = page_of(results, outputs)
    for frame in results["frames"]:
        for probe in frame["probes"]:
            assert f"{probe['name']}: {format_number(probe['shc_rmse'])}" in whole
    assert whole.count("frame 3 (0.07\u202fs)\nno position in view") == 5


def test_what_is_undefined_or_out_of_view_is_a_gap_in_the_curve(tmp_path):
    results, outputs = synthetic(tmp_path, n_frames=9, names=("Vase",))
    assert _pieces_and_lines(page_of(results, outputs)) == [(1, 8), (1, 7), (1, 8)]
    results["frames"][4]["probes"][0]["change"] = None
    assert _pieces_and_lines(page_of(results, outputs)) == [(1, 8), (2, 5), (1, 8)]
    results["frames"][4]["probes"] = []
    assert _pieces_and_lines(page_of(results, outputs)) == [(2, 6), (2, 5), (2, 6)]


def _pieces_and_lines(page: str) -> list[tuple[int, int]]:
    """Of the curves of error, change and coverage."""
    return [(path.count("M"), path.count("L")) for path in re.findall(r'<path class="line s0 d0" d="([^"]+)"', page)]


def test_one_slow_frame_does_not_flatten_the_others(tmp_path):
    results, outputs = synthetic(tmp_path, n_frames=12)
    totals = [sum(frame["stage_ms"].values()) for frame in results["frames"]]
    page = Page(page_of(results, outputs))
    assert totals[0] > 5 * max(totals[1:])
    assert f" {format_number(totals[0])} ms " in page.text
    assert not [word for word in page.words if word.strip() in ("20", "40", "60")]
