"""Profiles of phones: what ships, what a user writes, and what a mistake says."""

import dataclasses
import pickle

import pytest

from xihenet.phone.depth import RangeLimits
from xihenet.phone.profile import EFFECTS, PROFILES_FOLDER, PhoneProfile, load_profile, profile_names

RANGE = '[range]\nsource = "mine"\nnearest_m = 0.1\nfarthest_m = 4.0\n'
HEAD = 'name = "Mine"\nsummary = "A phone"\n'


def written(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return path


def as_toml(profile):
    lines = [f'name = "{profile.name}"', f'summary = "{profile.summary}"', f'metering = "{profile.metering}"']
    for effect, section in profile.sections.items():
        lines.append(f"[{effect}]")
        for part in dataclasses.fields(section):
            value = getattr(section, part.name)
            lines.append(f"{part.name} = {str(value).lower() if isinstance(value, bool) else _quoted(value)}")
    return "\n".join(lines)


def _quoted(value):
    return f"'''{value}'''" if isinstance(value, str) else repr(value)


def test_devices_ship_that_have_every_effect_and_the_perfect_one_has_none():
    assert load_profile("perfect").effects == frozenset()
    assert frozenset().union(*(load_profile(name).effects for name in profile_names())) == set(EFFECTS)


@pytest.mark.parametrize("name", profile_names())
def test_every_shipped_number_has_a_source_and_highlights_are_protected(name):
    profile = load_profile(name)
    assert profile.name and profile.summary and profile.metering == "highlights"
    assert 'metering = "highlights"' in (PROFILES_FOLDER / f"{name}.toml").read_text(encoding="utf-8")
    assert all(len(section.source) > 20 for section in profile.sections.values())


@pytest.mark.parametrize("name", profile_names())
def test_a_profile_written_and_read_again_or_sent_to_another_process_is_the_same(name, tmp_path):
    profile = load_profile(name)
    assert load_profile(written(tmp_path, as_toml(profile))) == profile == pickle.loads(pickle.dumps(profile))


def test_a_profile_that_says_nothing_of_metering_protects_highlights(tmp_path):
    assert load_profile(written(tmp_path, HEAD)).metering == "highlights"
    assert load_profile(written(tmp_path, HEAD + 'metering = "key"')).metering == "key"


def test_published_figures_are_in_the_profiles():
    ipad, kinect = load_profile("ipad_pro_lidar").sections, load_profile("azure_kinect").sections
    assert (ipad["frame_rate"].width_px, ipad["frame_rate"].rate_hz, ipad["range"].farthest_m) == (256, 60, 5.0)
    assert (kinect["noise"].shift_px, kinect["noise"].sigma_m, kinect["noise"].growth) == (0.25, 0.0005, 0.001)
    assert kinect["span_dropout"].span_m == 0.8
    assert kinect["dark_dropout"].below_grey == pytest.approx(15 / 255, abs=1e-4)


def test_a_users_file_is_a_profile_and_may_leave_effects_out(tmp_path):
    profile = load_profile(written(tmp_path, HEAD + RANGE))
    assert profile.effects == {"range"}
    assert profile.sections["range"].farthest_m == 4.0


def test_effects_come_in_one_order_however_the_file_has_them(tmp_path):
    steps = '[quantisation]\nsource = "mine"\nstep_m = 0.001\n'
    swapped = load_profile(written(tmp_path, HEAD + steps + RANGE))
    assert list(swapped.sections) == [effect for effect in EFFECTS if effect in swapped.sections]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (RANGE, "name: expected some text, got None"),
        (HEAD + RANGE.replace("4.0", '"far"'), r"\[range\] farthest_m: expected a number .* got 'far'"),
        (HEAD + RANGE.replace("4.0", "true"), r"\[range\] farthest_m: expected a number .* got True"),
        (HEAD + RANGE.replace("4.0", "nan"), r"\[range\] farthest_m: expected a number .* got nan"),
        (HEAD + RANGE.replace("4.0", "inf"), r"\[range\] farthest_m: expected a number .* got inf"),
        (HEAD + RANGE.replace("4.0", "-4.0"), r"\[range\] farthest_m: expected a number .* got -4"),
        (HEAD + RANGE.replace("4.0", "0.05"), r"\[range\] farthest_m: expected more than nearest_m"),
        (HEAD + RANGE.replace("farthest_m", "farthest"), r"\[range\] farthest: there is no such setting"),
        (HEAD + RANGE.replace("nearest_m = 0.1\n", ""), r"\[range\] nearest_m: this setting is missing"),
        (HEAD + RANGE.replace('"mine"', '" "'), r"\[range\] source: expected some text"),
        (HEAD + RANGE.replace("[range]", "[rang]"), r"\[rang\]: there is no such effect"),
        (HEAD + "range = 3", r"\[range\] expected a table"),
        (HEAD + "range = [[", "this is no TOML file"),
        (HEAD + "range = " + "[" * 200_000, "this is no TOML file"),
        (HEAD + RANGE.replace("4.0", "1" * 400), r"\[range\] farthest_m: expected a number"),
        (HEAD + 'metering = "spot"', "metering: expected one of highlights, key, got 'spot'"),
        (HEAD + "metering = [1]", r"metering: expected one of highlights, key, got \[1\]"),
        (HEAD.replace('"A phone"', "7"), "summary: expected some text, got 7"),
    ],
)
def test_a_mistake_is_one_line_that_names_file_and_key(tmp_path, text, says):
    with pytest.raises(ValueError, match=says) as error:
        load_profile(written(tmp_path, text))
    assert str(error.value).startswith(str(tmp_path / "mine.toml"))
    assert "\n" not in str(error.value)


def test_a_file_that_is_not_text_is_refused_by_name(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match=r"mine\.toml: this is no TOML file.* in UTF-8: save it"):
        load_profile(path)


def test_an_unknown_name_lists_the_names_there_are():
    with pytest.raises(ValueError, match="choose one of azure_kinect, ipad_pro_lidar"):
        load_profile("nokia_3310")


def test_a_profile_refuses_settings_of_another_effect():
    limits = RangeLimits(source="mine", nearest_m=0, farthest_m=1)
    with pytest.raises(ValueError, match="noise: expected DistanceNoise"):
        PhoneProfile("Mine", "A phone", {"noise": limits})
