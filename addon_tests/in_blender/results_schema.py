"""What results.json promises (schema version 1), checked value by value, and which of its numbers are times."""

import itertools
import json
import math

FRAME_TIMES = {"render_s", "work_s", "stage_ms", "comparison_render_s"}
SUMMARY_TIMES = {"render_s", "comparison_render_s", "overhead_share", "mean_step_ms"}
STAGES = {"unproject", "sample", "merge", "trigger", "encode", "estimate"}
METRICS = {"psnr", "ssim", "rmse", "si_rmse", "angular_deg"}
REASONS = {"first", "colour", "coverage", "none"}
PARTS = {"schema_version", "software", "machine", "settings", "scene", "effects", "frames", "comparison", "summary"}


def read_strictly(path):
    """The JSON of a file; a NaN or an Infinity in it is an error."""

    def refuse(constant):
        raise ValueError(f"{path}: {constant} is no JSON")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


def without_times(results):
    """A copy without what two equal runs may differ in: times, and how the command was typed."""
    copy = json.loads(json.dumps(results))
    copy["frames"] = [{k: v for k, v in entry.items() if k not in FRAME_TIMES} for entry in copy["frames"]]
    copy["summary"] = {k: v for k, v in copy["summary"].items() if k not in SUMMARY_TIMES}
    del copy["software"]["command"]
    return copy


def check_results(results):
    """AssertionError where `results` is not what design promises."""
    assert results["schema_version"] == 1
    assert set(results) >= PARTS
    for part in ("software", "machine"):
        assert all(isinstance(value, str | int) for value in results[part].values()), part
    assert results["settings"]["target"] in ("ldr", "hdr")
    for effect in results["effects"]:
        assert set(effect) == {"name", "state", "reason"}
        assert effect["state"] in ("on", "off") and all(effect.values())
    assert [entry["frame"] for entry in results["frames"]] == results["settings"]["frames"]
    for entry in results["frames"]:
        _check_frame(entry)
    _check_comparison(results)
    _check_summary(results)


def _check_frame(entry):
    assert isinstance(entry["frame"], int) and isinstance(entry["active"], bool)
    assert math.isfinite(entry["time_s"])
    assert _is_number(entry["render_s"]) and entry["render_s"] >= 0
    assert set(entry["stage_ms"]) <= STAGES
    assert all(_is_number(ms) and ms >= 0 for ms in entry["stage_ms"].values())
    # `probes` lists active positions only, so that a frame is active exactly when it lists any.
    assert entry["active"] == bool(entry["probes"])
    assert entry["active"] == (entry["render_s"] > 0)
    for probe in entry["probes"]:
        _check_probe(probe)
    if "estimate" in entry["stage_ms"]:
        assert any(probe["fired"] for probe in entry["probes"])


def _check_probe(probe):
    assert isinstance(probe["name"], str) and probe["name"].startswith(probe["object"])
    assert _are_numbers(probe["position_m"], 3)
    assert 0 <= probe["coverage"] <= 1
    assert isinstance(probe["fired"], bool) and probe["reason"] in REASONS
    assert probe["fired"] == (probe["reason"] != "none")
    assert (probe["change"] is None) == (probe["reason"] == "first")
    assert probe["change"] is None or probe["change"] >= 0
    assert isinstance(probe["payload_bytes"], int)
    assert probe["fired"] == (probe["payload_bytes"] > 0)
    for name in ("sh", "sh_truth"):
        assert len(probe[name]) == 9 and all(_are_numbers(triple, 3) for triple in probe[name]), name
    assert _is_number(probe["shc_rmse"]) and probe["shc_rmse"] >= 0
    pairs = zip(itertools.chain(*probe["sh"]), itertools.chain(*probe["sh_truth"]), strict=True)
    rmse = math.sqrt(sum((a - b) ** 2 for a, b in pairs) / 27)
    assert math.isclose(probe["shc_rmse"], rmse, rel_tol=1e-9)


def _check_comparison(results):
    compared = [entry for entry in results["frames"] if "comparison" in entry]
    methods = {results["settings"]["estimator"], "ambient", "truth"} if compared else set()
    assert set(results["comparison"]) == methods
    for entry in compared:
        assert entry["active"] and set(entry["comparison"]) == methods
    for of_one in [results["comparison"], *(entry["comparison"] for entry in compared)]:
        for metrics in of_one.values():
            assert set(metrics) == METRICS
            assert all(value is None or _is_number(value) for value in metrics.values())


def _check_summary(results):
    summary, frames = results["summary"], results["frames"]
    assert summary["n_frames"] == len(frames)
    assert summary["n_active_frames"] == sum(entry["active"] for entry in frames)
    assert summary["n_estimates"] == sum(probe["fired"] for entry in frames for probe in entry["probes"])
    assert summary["payload_bytes"] == sum(probe["payload_bytes"] for entry in frames for probe in entry["probes"])


def _is_number(value):
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _are_numbers(values, n):
    return len(values) == n and all(_is_number(value) for value in values)
