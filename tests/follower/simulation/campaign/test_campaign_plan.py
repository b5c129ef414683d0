"""What a campaign plans, and what it refuses."""

from dataclasses import replace
from pathlib import Path

import pytest

from follower.settings.settings import find_scenario
from follower.simulation.campaign.config import RunSpec, campaign_files, load_campaign, planned
from follower.simulation.campaign.fly import row_of
from follower.simulation.campaign.run import check, in_its_place
from follower_control.common.strict_config import SettingsError

MINE = """
name: mine
title: Mine.
runs: 20
seed: 3
vision: truth+noise
scenarios: [pursue-car, pursue-boat]
autopilots: [px4, ardupilot]
parameters:
  course: {key: scene.targets.0.path.shape.kind, values: [straight, winding]}
  wind: {keys: {scene.wind.mean_m_s: 1.0, scene.wind.gust_m_s: 0.5}, between: [0, 8]}
  yaw: {key: servo.azimuth.kp, between: [1, 2]}
"""


def written(folder: Path, text: str = MINE) -> str:
    path = folder / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_the_first_runs_are_the_same_however_many_are_drawn(tmp_path: Path) -> None:
    config = written(tmp_path)
    few = planned(load_campaign(config, runs=5))
    many = planned(load_campaign(config))
    assert many[:5] == few
    assert len({spec.key for spec in many}) == 20
    assert {spec.scenario for spec in many} == {"pursue-car", "pursue-boat"}
    assert {spec.autopilot for spec in many} == {"px4", "ardupilot"}


def test_a_drawn_parameter_goes_to_each_of_its_keys(tmp_path: Path) -> None:
    spec = planned(load_campaign(written(tmp_path)))[0]
    wind = float(spec.values["wind"])
    scene = dict(text.split("=") for text in spec.scene)
    assert float(scene["wind.mean_m_s"]) == wind
    assert float(scene["wind.gust_m_s"]) == pytest.approx(wind / 2, rel=1e-3)
    assert scene["targets.0.path.shape.kind"] == spec.values["course"]
    assert spec.overrides == (f"servo.azimuth.kp={spec.values['yaw']}",)
    assert 1 <= float(spec.values["yaw"]) <= 2
    for part in ("--lockstep", "--vision truth+noise", f"--seed {spec.seed}", "--scene wind."):
        assert part in spec.options().command


def test_without_a_number_of_runs_every_combination_is_flown(tmp_path: Path) -> None:
    text = MINE.replace("runs: 20", "repeats: 2").replace("between: [0, 8]", "values: [0, 4, 8]")
    text = text.replace("between: [1, 2]", "values: [1.5]")
    specs = planned(load_campaign(written(tmp_path, text)))
    assert len(specs) == 2 * 2 * 2 * 3 * 1 * 2
    assert {spec.seed for spec in specs} == {3, 4}
    assert len({spec.key for spec in specs}) == len(specs)


def test_the_key_knows_the_flight_and_not_its_number(tmp_path: Path) -> None:
    spec = planned(load_campaign(written(tmp_path)))[0]
    assert replace(spec, number=99).key == spec.key
    for change in ({"seed": 0}, {"vision": "pixels"}, {"scene": ()}, {"overrides": ("a=1",)}):
        assert replace(spec, **change).key != spec.key  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("seed: 3", "sed: 3", "unknown key 'sed'; did you mean 'seed'?"),
        ("runs: 20", "runs: 0", "runs: Input should be greater than or equal to 1"),
        ("pursue-boat", "pursue-bot", "there is no scenario 'pursue-bot'"),
        ("between: [1, 2]", "between: [2, 1]", "parameters.yaw: a parameter lies `between`"),
        ("between: [1, 2]", "value: [1]", "unknown key 'parameters.yaw.value'"),
        ("key: servo.azimuth.kp, ", "", "parameters.yaw: a parameter has either `key` or `keys`"),
        ("runs: 20", "repeats: 1", "parameter 'wind': every combination needs `values`"),
        ("vision: truth+noise", "vision: eyes", "vision: Input should be 'pixels' or"),
        ("[px4, ardupilot]", "[px5]", "autopilots[0]: Input should be 'px4' or 'ardupilot'"),
        ("seed: 3", "seed: 3\ngoals: {reacquired: 1}", "unknown key 'goals.reacquired'"),
        (
            "seed: 3",
            "seed: 3\noptimise: {seed: -1, settings: {servo.azimuth.kp: [0, 3]}}",
            "optimise.seed: Input should be greater than or equal to 0",
        ),
    ],
)
def test_a_campaign_that_cannot_be_used_is_refused_by_the_keys_name(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    with pytest.raises(SettingsError) as caught:
        load_campaign(written(tmp_path, MINE.replace(old, new)))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("servo.azimuth.kp", "servo.azimut.kp", "unknown key 'servo.azimut'"),
        ("scene.wind.mean_m_s", "scene.wind.mean", "unknown key 'wind.mean'"),
        ("targets.0.path", "targets.3.path", "'3' is no number from 0 to 0"),
    ],
)
def test_a_parameter_that_leads_nowhere_is_refused_before_all_flying(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    specs = planned(load_campaign(written(tmp_path, MINE.replace(old, new))))
    with pytest.raises(SettingsError) as caught:
        check(specs)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("more", "refused"),
    [
        ("scenarios: [pursue-car, pursue-boat, pursue-car]", "scenarios differ"),
        ("scenarios: [pursue-car]\nautopilots: [px4, px4]", "autopilots differ"),
        (
            "scenarios: [pursue-car]\nparameters: {s: {key: scene.seed, values: [1, 2]}}",
            "runs have seeds of their own",
        ),
        ("scenarios: [pursue-car]\nscene: [seed=5]", "runs have seeds of their own"),
        ("scenarios: [pursue-car]\nseed: 9223372036854775808", "seed: Input should be less"),
    ],
)
def test_no_flight_counts_twice(tmp_path: Path, more: str, refused: str) -> None:
    text = f"name: twice\ntitle: Twice.\n{more}\n"
    with pytest.raises(SettingsError, match=refused):
        load_campaign(written(tmp_path, text))
    if "differ" in refused:  # what is drawn has a seed of its own
        specs = planned(load_campaign(written(tmp_path, f"{text}runs: 6\n")))
        assert len({spec.key for spec in specs}) == 6


def test_an_unknown_campaign_is_named_with_those_that_there_are() -> None:
    with pytest.raises(SettingsError, match=r"no campaign 'all'.*quick, standard"):
        load_campaign("all")


@pytest.mark.parametrize("name", campaign_files())
def test_a_shipped_campaign_is_named_after_its_file_and_can_be_flown(name: str) -> None:
    config = load_campaign(name)
    assert config.name == name
    check(planned(config))


def test_the_standard_campaign_covers_what_was_asked() -> None:
    config = load_campaign("standard")
    specs = planned(config)
    assert len(specs) == 1000
    assert len(config.scenarios) == 4
    assert config.vision == "pixels"
    assert set(config.autopilots) == {"px4", "ardupilot"}
    assert config.parameters["latency_s"].between == (0.05, 0.2)
    assert len({spec.values["course"] for spec in specs}) == 5
    assert max(float(spec.values["wind_m_s"]) for spec in specs) > 9.5


FILED = """
name: filed
title: Files of its own.
scenarios: [own.yaml]
vision: truth+noise
config: own-settings.yaml
parameters: {gain: {key: servo.azimuth.kp, values: [0.2, 1.5]}}
"""


def filed(folder: Path, **texts: str) -> list[RunSpec]:
    scenario = find_scenario("pursue-person").read_text("utf-8")
    files = {"own.yaml": scenario, "own-settings.yaml": "", "filed.yaml": FILED}
    for name, text in (files | {key.replace("_", "."): one for key, one in texts.items()}).items():
        (folder / name).write_text(text, "utf-8")
    return planned(load_campaign(str(folder / "filed.yaml")))


def test_a_changed_file_of_settings_or_scenario_makes_other_flights(tmp_path: Path) -> None:
    keys = [spec.key for spec in filed(tmp_path)]
    assert [spec.key for spec in filed(tmp_path)] == keys
    other = "servo: {elevation: {kp: 0.4}}"
    settings = tmp_path / "own-settings.yaml"
    settings.write_text(other, "utf-8")
    assert not {one.key for one in planned(load_campaign(str(tmp_path / "filed.yaml")))} & {*keys}
    settings.write_text("", "utf-8")
    scenario = tmp_path / "own.yaml"
    scenario.write_text(scenario.read_text("utf-8") + "# another\n", "utf-8")
    assert not {one.key for one in planned(load_campaign(str(tmp_path / "filed.yaml")))} & {*keys}


def test_a_flight_that_was_another_run_has_its_place_in_this_campaign(tmp_path: Path) -> None:
    before = filed(tmp_path)
    edited = FILED.replace("gain: ", "kp: ").replace("[0.2, 1.5]", "[0.1, 0.2, 1.5]")
    after = filed(tmp_path, filed_yaml=edited)
    assert [spec.key for spec in after[1:]] == [spec.key for spec in before]
    rows = {spec.key: row_of(spec) for spec in before} | {after[0].key: row_of(after[0])}
    shown = [in_its_place(rows[spec.key], spec) for spec in after]
    assert [one["number"] for one in shown] == [0, 1, 2]
    assert [one["values"] for one in shown] == [{"kp": 0.1}, {"kp": 0.2}, {"kp": 1.5}]


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        (
            "{a: {key: servo.azimuth.kp, values: [1]}, b: {key: servo.azimuth.kp, values: [2]}}",
            "'a' and 'b' both set servo.azimuth.kp",
        ),
        ("{a: {key: servo.azimuth.kp, values: [1.5, 1.5]}}", "count twice"),
        ("{a: {key: servo.azimuth.kp, values: [1, 1.0]}}", "count twice"),
        ("{a: {key: servo.azimuth.kp, between: [-1.0e+308, 1.0e+308]}}", "a smaller and a larger"),
        ("{a: {keys: {servo.azimuth.kp: 1.0}, values: [abc]}}", "values are numbers"),
    ],
)
def test_parameters_that_contradict_themselves_are_refused(
    tmp_path: Path, parameters: str, says: str
) -> None:
    text = FILED.replace("{gain: {key: servo.azimuth.kp, values: [0.2, 1.5]}}", parameters)
    with pytest.raises(SettingsError, match=says):
        filed(tmp_path, filed_yaml=text)


def test_more_runs_than_anybody_flies_and_shares_beyond_one_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="at most 1,000,000"):
        filed(tmp_path, filed_yaml=FILED + "repeats: 100000000\n")
    with pytest.raises(SettingsError, match=r"goals\.min_in_frame_share"):
        filed(tmp_path, filed_yaml=FILED + "goals: {min_in_frame_share: 2}\n")
