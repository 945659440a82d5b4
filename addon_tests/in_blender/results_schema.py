"""What results.json promises beyond its schema: how its values hang together, and which of them are times."""

import itertools
import json
import math
import re

from jsonschema import Draft202012Validator

from xihe_blender.capture.reference_probe import ERROR_BESIDE_NOISE
from xihe_blender.io.json_records import as_json, from_json, json_schema
from xihe_blender.io.run_results import RunResults
from xihenet.invalid import CLAMPED, UNKNOWN, format_reason
from xihenet.phone import PHONE_EFFECTS

FRAME_TIMES = {"render_s", "work_s", "stage_ms", "others_ms", "comparison_render_s"}
SUMMARY_TIMES = {"render_s", "pilot_s", "comparison_render_s", "overhead_share", "mean_step_ms", "estimate_ms"}
STAGES = {"unproject", "sample", "merge", "trigger", "encode", "estimate", "reflect"}
SCHEMA = Draft202012Validator(json_schema(RunResults))


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
    copy["notes"] = [re.sub(r"in \d+ s\b", "in some s", note) for note in copy["notes"]]
    del copy["software"]["command"]
    return copy


def check_results(results):
    """AssertionError where `results` is not what design promises."""
    SCHEMA.validate(json.loads(json.dumps(results)))
    assert as_json(from_json(RunResults, results)) == results
    assert results["settings"]["metering"] in ("highlights", "key", None)
    assert all(
        fault["name"] and fault["n"] >= 1 and fault["said"] in results["notes"] for fault in results["scene"]["faults"]
    )
    faults = {fault["said"] for fault in results["scene"]["faults"]}
    assert faults <= set(results["warnings"]) <= set(results["notes"])
    _check_effects(results)
    assert [entry["frame"] for entry in results["frames"]] == results["settings"]["frames"]
    for entry in results["frames"]:
        _check_frame(entry, results["settings"])
    _check_lights(results)
    _check_comparison(results)
    _check_summary(results)


def _check_effects(results):
    """Every effect once, and the phone's errors for those of the phone and the session that are on."""
    names = [effect["name"] for effect in results["effects"]]
    assert len(names) == len(set(names))
    for effect in results["effects"]:
        assert effect["name"] and effect["reason"]
        assert effect["origin"] == ("user" if effect["name"] in _chosen(results) else "auto")
    phone, settings = results["phone"], results["settings"]
    assert phone["name"] and phone["summary"] and settings["phone"]
    on = {effect["name"] for effect in results["effects"] if effect["state"] == "on"} & set(PHONE_EFFECTS)
    errors = phone["shc_rmse"]
    assert (errors is None) == (not on)
    if errors is not None:
        assert set(errors["without"]) == on
        assert errors["all_on"] == results["summary"]["mean_shc_rmse"]


def _chosen(results):
    """Names of the effects that the user turned on or off, as far as phone and session have them."""
    chosen = results["settings"]["effect_choices"]
    assert set(chosen.values()) <= {"on", "off"}
    # One that the phone or the session does not have has no numbers.
    there = {effect["name"] for effect in results["effects"] if effect["parameters"]}
    return {name for name in chosen if name not in PHONE_EFFECTS or name in there}


def _check_frame(entry, settings):
    assert entry["render_s"] >= 0
    assert set(entry["stage_ms"]) <= STAGES and all(ms >= 0 for ms in entry["stage_ms"].values())
    # `probes` lists active positions only, so that a frame is active exactly when it lists any.
    assert entry["active"] == bool(entry["probes"])
    if entry["active"]:
        assert entry["captured"]
    if entry["captured"]:
        _check_rendering(entry, ERROR_BESIDE_NOISE[settings["target"]])
    else:
        assert entry["render_s"] == 0
    assert entry["is_delivered"] or not entry["active"]
    assert all(n >= 0 for n in entry["n_lost_pixels"].values())
    _check_counts(entry["invalid"], entry["n_invalid_pixels"])
    for probe in entry["probes"]:
        _check_probe(probe)
        _check_arrival(probe, entry["frame"], settings["frames"])
    if "estimate" in entry["stage_ms"]:
        assert any(probe["fired"] for probe in entry["probes"])


def _check_counts(counts, n_left_out):
    """Every reason has words and a count, and those that leave something out add up."""
    assert all(n > 0 and format_reason(reason) for reason, n in counts.items())
    assert sum(n for reason, n in counts.items() if reason not in CLAMPED) == n_left_out


def _check_rendering(entry, beside_noise):
    capture, probes = entry["rendering"]["capture"], entry["rendering"]["probes"]
    assert set(probes) == {probe["name"] for probe in entry["probes"]}
    renders = [capture, *probes.values()]
    for probe in probes.values():
        assert (probe["expected_error"] is None) == (probe["noise"] is None)
        assert probe["noise"] is None or probe["noise"] < probe["expected_error"] <= probe["noise"] + beside_noise
    for render in renders:
        assert render["samples"] >= 1 and (render["noise"] is None or render["noise"] >= 0)
        assert render["rendered"] == (render["same_as"] is None)
        assert render["rendered"] or render["same_as"] < entry["frame"]
    assert (entry["render_s"] > 0) == any(render["rendered"] for render in renders)


def _check_probe(probe):
    assert probe["name"].startswith(probe["object"])
    assert 0 <= probe["coverage"] <= 1
    assert probe["fired"] == (probe["reason"] != "none")
    assert (probe["change"] is None) == (probe["reason"] == "first")
    assert probe["change"] is None or probe["change"] >= 0
    _check_counts(probe["invalid"], probe["n_invalid_points"])
    assert probe["is_valid"] == (probe["unknown_because"] is None)
    assert probe["is_valid"] or probe["unknown_because"] in UNKNOWN
    assert probe["n_followed_anchors"] >= 0 and (probe["fired"] or not probe["n_followed_anchors"])
    assert probe["fired"] == (probe["payload_bytes"] > 0)
    above = probe["share_above_white"]
    assert above is None or 0 <= above <= 1
    assert len(probe["sh"]) == len(probe["sh_truth"]) == 9
    pairs = zip(itertools.chain(*probe["sh"]), itertools.chain(*probe["sh_truth"]), strict=True)
    rmse = math.sqrt(sum((a - b) ** 2 for a, b in pairs) / 27)
    assert math.isclose(probe["shc_rmse"], rmse, rel_tol=1e-9)


def _check_arrival(probe, frame, frames):
    latency, arrives, source = probe["latency_ms"], probe["arrival_frame"], probe["light_frame"]
    assert source is None or (source in frames and source <= frame)
    assert latency is None or (latency >= 0 and probe["fired"])
    assert arrives is None or (arrives in frames and arrives >= frame and latency is not None)


def _check_comparison(results):
    compared = [entry for entry in results["frames"] if "comparison" in entry]
    methods = (
        {results["settings"]["estimator"], *results["settings"]["others"], "ambient", "truth"} if compared else set()
    )
    assert set(results["comparison"]) == methods
    for entry in compared:
        assert entry["active"] and set(entry["comparison"]) == set(entry["n_hueless_pixels"]) == methods


def _check_summary(results):
    summary, frames = results["summary"], results["frames"]
    probes = [probe for entry in frames for probe in entry["probes"]]
    _check_counts(summary["invalid"]["pixels"], summary["n_invalid_pixels"])
    _check_counts(summary["invalid"]["points"], summary["n_invalid_points"])
    assert sum(summary["invalid"]["lights"].values()) == summary["n_unknown_lights"]
    for name in ("n_invalid_points", "n_followed_anchors", "payload_bytes"):
        assert summary[name] == sum(probe[name] for probe in probes), name
    assert summary["n_unknown_lights"] == sum(not probe["is_valid"] for probe in probes)
    assert summary["n_frames"] == len(frames)
    assert summary["n_active_frames"] == sum(entry["active"] for entry in frames)
    fired = [probe for probe in probes if probe["fired"]]
    assert summary["n_estimates"] == len(fired)
    assert summary["n_lost"] == sum(probe["latency_ms"] is None for probe in fired)
    assert (summary["mean_latency_ms"] is None) == (summary["n_lost"] == len(fired))


def _check_lights(results):
    """The light of every object, by the frames at which it changes; of one with a single position that of its probe."""
    lights = results["lights"]
    assert list(lights) == results["scene"]["virtual_objects"]
    active = [entry["frame"] for entry in results["frames"] if entry["active"]]
    for changes in lights.values():
        frames = [change["frame"] for change in changes]
        assert frames == sorted(set(frames)) and frames[:1] == active[:1]
        assert all(len(change["sh"]) == 9 for change in changes)
    for entry in results["frames"]:
        for probe in entry["probes"]:
            if probe["name"] == probe["object"]:
                reached = [change for change in lights[probe["object"]] if change["frame"] <= entry["frame"]]
                assert reached[-1]["sh"] == probe["sh"]
