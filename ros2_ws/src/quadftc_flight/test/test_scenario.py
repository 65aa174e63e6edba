"""Scenario files: what is shipped loads; what is wrong is refused with file, line and key."""

import math
import re
from pathlib import Path

import pytest

from quadftc_control.controller import controller_from
from quadftc_control.guidance import flight_guidance_from, stand_guidance_from
from quadftc_fdi.disturbance_observer import disturbance_observer_from
from quadftc_fdi.fault_observer import fault_observer_from
from quadftc_flight.checks import refuse_wrong_checks
from quadftc_flight.scenario import (
    ScenarioError,
    estimator_for,
    find_scenario,
    label_of,
    load_scenario,
    node_parameters,
    parse_scenario,
    relabelled,
    scenario_names,
    with_components,
    with_duration,
    with_rate,
    with_seed,
)
from quadftc_flight.scenario.document import read_document
from quadftc_model.assembly import node_values
from quadftc_sim.assembly import injector_from, simulator_from
from quadftc_sim.fault import faults

SHIPPED = sorted((Path(__file__).resolve().parents[4] / "scenarios").glob("*.yaml"))
KINDS = ("faults", "constant_disturbance", "varying_disturbance")
PAPERS = [
    path
    for path in SHIPPED
    if path.stem in {f"{grade}_{kind}" for grade in ("paper", "mems") for kind in KINDS}
]
DEG = math.pi / 180.0

TEXT = """\
name: tried
description: what the tests try
duration: 10 s
rate: 250 Hz
seed: 7
vehicle: qball_x4
plant:
  motor_lag: false
sensors:
  grade: mems
  gyro_bias: 0.5 deg/s
references:
  - {kind: step, angles: [5 deg, 0, 0.1], start: 1 s, stop: 8 s}
disturbances:
  - {kind: constant, amplitude: 50 mN m, start: 2 s}
faults:
  - {kind: bias, channel: attitude, axes: roll, value: 1 deg, start: 3 s, stop: 5 s}
  - {kind: noise, channel: gyro, axes: [x, z], sigma: 2 deg/s, start: 3 s, duration: 2 s}
schemes:
  ours:
    observer: {kind: sliding_mode, delta: 0.002}
    disturbance_observer: exosystem
    controller: ismc
    checks:
      - {metric: tracking_rmse_deg, below: 1}
      - {metric: fault_windows.0.tracking_mean_deg, axis: roll, above: -1, below: 1}
  plain:
    controller: pid
"""


def refusal(text: str, overrides=()) -> list[str]:
    with pytest.raises(ScenarioError) as caught:
        refuse_wrong_checks(parse_scenario(text, "tried.yaml", overrides))
    return str(caught.value).splitlines()


@pytest.mark.parametrize("path", PAPERS, ids=lambda path: path.stem)
def test_scenario_of_the_paper_loads_as_it_has_it(path):
    scenario = load_scenario(path)
    assert scenario.name == path.stem
    assert (scenario.duration, scenario.rate) == (80.0, 250.0)
    assert [tuple(window) for window in scenario.fault_windows] == [
        (20.0, 40.0, ("roll", "pitch", "yaw")),
        (50.0, 70.0, ("roll", "pitch", "yaw")),
    ]
    proposed, conventional = scenario.scheme("proposed"), scenario.scheme("conventional")
    supervised = {"supervised"} if path.stem.startswith("mems") else set()
    assert set(scenario.schemes) - {"indi"} == {"proposed", "conventional"} | supervised
    assert scenario.scheme() is proposed
    assert [proposed.observer.kind, proposed.disturbance_observer.kind, proposed.controller.kind] == [
        "sliding_mode",
        "exosystem",
        "ismc",
    ]
    assert [conventional.observer.kind, conventional.controller.kind] == ["none", "smc"]
    assert proposed.checks
    assert conventional.checks


def test_all_scenarios_of_the_paper_are_shipped():
    assert len(PAPERS) == 2 * len(KINDS)


@pytest.mark.parametrize("channel", ["attitude", "gyro", "accelerometer"])
def test_a_catalogue_scenario_has_every_kind_of_fault(channel):
    name = "mems_catalogue" if channel == "attitude" else f"{channel}_catalogue"
    found = [fault.injection for fault in load_scenario(find_scenario(name)).faults]
    possible = {kind for kind in faults.names() if {channel, "imu"} & {*faults.get(kind).channels}}
    assert {each.kind for each in found} == possible
    assert {each.channel for each in found} <= {channel, "imu"}


@pytest.mark.parametrize("kind", KINDS)
def test_mems_scenario_is_the_papers_but_for_sensors_checks_and_schemes_more(kind):
    by_name = {path.stem: load_scenario(path) for path in SHIPPED}
    paper, mems = by_name[f"paper_{kind}"].raw, by_name[f"mems_{kind}"].raw
    assert mems["schemes"].pop("supervised")["observer"] == "supervised"  # with its defaults
    mems["schemes"].pop("indi", None)
    for raw in (paper, mems):
        for scheme in raw["schemes"].values():
            del scheme["checks"]
    assert {key for key in paper if paper[key] != mems[key]} == {"name", "description", "sensors"}


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_node_parameters_build_the_very_parts_of_the_scenario(path):
    scenario = load_scenario(path)
    for scheme in scenario.schemes.values():
        parameters = node_parameters(scenario, scheme)
        roles = {
            "observer": fault_observer_from(parameters["fault_observer"]),
            "disturbance_observer": disturbance_observer_from(parameters["disturbance_observer"]),
            "controller": controller_from(parameters["controller"]),
        }
        for role, law in roles.items():
            assert type(law) is type(getattr(scheme, role).law)
            assert node_values(law, "") == node_values(getattr(scheme, role).law, "")
        simulator = simulator_from(parameters["plant"])
        assert node_values(simulator.plant, "") == node_values(scenario.plant, "")
        assert node_values(simulator.law.imu, "") == node_values(scenario.sensor, "")
        assert simulator.period_ns == 4_000_000
        parts = {"disturbances": simulator.plant.disturbances}
        if scenario.plant.flies:
            position = simulator.law.position.sensor
            assert node_values(position, "") == node_values(scenario.position_sensor, "")
            guidance = flight_guidance_from(parameters["position_controller"])
            loop = guidance.loop
            assert node_values(loop.estimator, "") == node_values(estimator_for(scenario), "")
            assert node_values(loop.controller, "") == node_values(scheme.position_controller.law, "")
            parts["winds"] = simulator.plant.winds
            parts["trajectories"] = guidance.trajectories
        else:
            parts["references"] = stand_guidance_from(parameters["reference"]).references
        for key, laws in parts.items():
            assert [node_values(law, "") for law in laws] == [
                node_values(part.law, "") for part in getattr(scenario, key)
            ]
        injections = injector_from(parameters["fault_injector"]).injections.values()
        for injection, fault in zip(injections, scenario.faults, strict=True):
            assert (injection.start, injection.stop) == (fault.injection.start, fault.injection.stop)
            assert injection.mask.tolist() == fault.injection.mask.tolist()
            assert node_values(injection.law, "") == node_values(fault.injection.law, "")


def test_units_become_si_and_vectors_lists():
    parameters = node_parameters(parse_scenario(TEXT), "ours")
    assert parameters["plant"]["rate"] == 250.0
    assert parameters["plant"]["duration"] == 10.0
    assert parameters["plant"]["imu.gyro_bias"] == 0.5 * DEG
    assert parameters["plant"]["imu.delay"] == 1  # of the grade
    assert parameters["plant"]["disturbances"] == ["constant amplitude=0.05 start=2.0"]
    assert parameters["fault_injector"]["faults"] == [
        f"bias channel=attitude axes=roll start=3.0 stop=5.0 value={1.0 * DEG!r}",
        f"noise channel=gyro axes=roll,yaw start=3.0 stop=5.0 sigma={2.0 * DEG!r}",
    ]
    assert parameters["fault_observer"]["sliding_mode.delta"] == 0.002
    assert parameters["controller"]["ismc.k_c1"] == [16.0, 16.0, 9.0]
    plain = node_parameters(parse_scenario(TEXT), "plain")
    assert plain["fault_observer"] == {"vehicle": "qball_x4", "observer": "none"}


@pytest.mark.parametrize(
    ("old", "new", "key", "what"),
    [
        ("value: 1 deg", "value: 1 dge", "faults[0].value", "'1 dge': 'dge' is not a unit"),
        ("value: 1 deg", "valeu: 1 deg", "faults[0].valeu", "unknown key (did you mean 'value'?)"),
        ("value: 1 deg", "value: [1, 2]", "faults[0].value", "expected one number or 3"),
        ("value: 1 deg", "value: .nan", "faults[0].value", "not NaN"),
        ("value: 1 deg", "value: .inf", "faults[0].value", "must be finite"),
        ("value: 1 deg", "value: {a: 1}", "faults[0].value", "expected a number"),
        ("kind: bias", "kind: bais", "faults[0].kind", "no fault 'bais' (did you mean 'bias'?)"),
        ("kind: bias, ", "", "faults[0].kind", "missing key"),
        ("axes: roll", "axes: rol", "faults[0].axes", "'rol' is no axis"),
        ("axes: roll", "axes: [roll, 2]", "faults[0].axes", "2 is no axis; expected roll, pitch"),
        ("channel: attitude", "channel: imu", "faults[0].channel", "bias can be on attitude, gyro"),
        ("channel: gyro", "channel: gyroscope", "faults[1].channel", "expected one of attitude, gyro"),
        ("stop: 5 s", "stop: 2 s", "faults[0].stop", "must be later than start = 3 s"),
        ("stop: 5 s", "stop: 15 s", "faults[0].stop", "beyond the end of the flight, 10 s"),
        ("start: 3 s, stop", "start: -3 s, stop", "faults[0].start", "must not be negative"),
        ("start: 3 s, stop: 5 s", "start: 10 s", "faults[0].start", "before the end of the flight"),
        ("duration: 2 s", "duration: 20 s", "faults[1].duration", "beyond the end of the flight"),
        ("duration: 2 s", "duration: 0", "faults[1].duration", "must be positive"),
        ("start: 2 s", "start: -2 s", "disturbances[0].start", "must be within [0, inf]"),
        ("50 mN m", "50 mm", "disturbances[0].amplitude", "'mm' is not a unit"),
        ("stop: 8 s", "stop: 0.5 s", "references[0].stop", "must be later than start = 1 s"),
        ("kind: step", "kind: stp", "references[0].kind", "no reference 'stp'"),
        ("duration: 10 s", "duration: -10 s", "duration", "must be within [0.1, 3600] s"),
        ("duration: 10 s", "duration: .nan", "duration", "not NaN"),
        ("duration: 10 s", "duration: 2 h", "duration", "'h' is not a unit"),
        ("rate: 250 Hz", "rate: 9 Hz", "rate", "must be within [10, 4000] Hz"),
        ("rate: 250 Hz", "rate: 4001", "rate", "must be within [10, 4000] Hz"),
        ("rate: 250 Hz", "rate: [250]", "rate", "expected a number in Hz"),
        ("seed: 7", "seed: -7", "seed", "must be greater than or equal to 0"),
        ("seed: 7", "seed: 0.5", "seed", "expected a whole number"),
        ("seed: 7", "sede: 7", "sede", "unknown key (did you mean 'seed'?)"),
        ("seed: 7", "rate: 7", "rate", "given twice, first in line 4"),
        ("name: tried", "name: a/b", "name", "expected letters, digits"),
        ("vehicle: qball_x4", "vehicle: qball", "vehicle", "no vehicle 'qball'"),
        ("vehicle: qball_x4", "vehicle: none.toml", "vehicle", "No such file"),
        ("motor_lag: false", "motor_lag: 2", "plant.motor_lag", "expected true or false"),
        ("motor_lag: false", "motor_leg: true", "plant.motor_leg", "did you mean 'motor_lag'"),
        ("motor_lag: false", "substeps: 0", "plant.substeps", "must be within [1, 1000]"),
        ("motor_lag: false", "motor_bandwidth: 20", "plant.motor_bandwidth", "motor_lag is false"),
        ("motor_lag: false", "inertia_factor: 0.1", "plant.inertia_factor", "must be within [0.2, 5]"),
        ("motor_lag: false", "inertia_factor: [1, 2]", "plant.inertia_factor", "expected one number or 3"),
        ("grade: mems", "grade: memes", "sensors.grade", "expected one of ideal, mems"),
        ("gyro_bias: 0.5 deg/s", "gyro_bias: -1", "sensors.gyro_bias", "must be within [0, inf]"),
        ("gyro_bias: 0.5 deg/s", "delay: .inf", "sensors.delay", "expected a whole number"),
        ("delta: 0.002", "delta: 0", "schemes.ours.observer.delta", "must be within"),
        ("delta: 0.002", "dleta: 1", "schemes.ours.observer.dleta", "did you mean 'delta'"),
        ("controller: ismc", "controller: imsc", "schemes.ours.controller.kind", "did you mean 'ismc'"),
        ("  plain:", "  pl ain:", "schemes.pl ain", "expected letters, digits"),
        ("tracking_rmse_deg", "tracking_rms_deg", "schemes.ours.checks[0].metric", "did you mean"),
        ("fault_windows.0", "fault_windows.1", "schemes.ours.checks[1].metric", "no '1'; there is: 0"),
        ("axis: roll", "axis: rol", "schemes.ours.checks[1].axis", "expected one of roll, pitch, yaw"),
        ("tracking_rmse_deg", "fault_windows", "schemes.ours.checks[0].metric", "is no number"),
        ("deg, below: 1}", "deg}", "schemes.ours.checks[0]", "expected 'above' or 'below'"),
        ("above: -1", "above: 2", "schemes.ours.checks[1]", "must be less than below"),
    ],
)
def test_a_mistake_is_refused_with_its_line_and_key(old, new, key, what):
    assert TEXT.count(old) >= 1
    (line,) = refusal(TEXT.replace(old, new, 1))
    number = next(n for n, text in enumerate(TEXT.splitlines(), 1) if old.strip() in text)
    assert line.startswith(f"tried.yaml:{number}: {key}: "), line
    assert what in line
    assert len(line) < 600


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TEXT.replace("controller: pid", ""), "tried.yaml:27: schemes.plain: None: expected a mapping"),
        (
            TEXT.replace("controller: pid", "observer: none"),
            "tried.yaml:27: schemes.plain.controller: missing key",
        ),
        ("", "tried.yaml:1: empty; expected a mapping of keys"),
        ("# nothing\n", "tried.yaml:1: empty; expected a mapping of keys"),
        ("- a\n", "tried.yaml:1: expected a mapping of keys such as 'duration: 80 s'"),
        ("name: x\nrate: [1\n", "tried.yaml:3: not YAML: "),
        ("name: x\nrate: a: b\n", "tried.yaml:2: not YAML: mapping values are not allowed here"),
        ("name: \0", "tried.yaml:1: not YAML: special characters are not allowed"),
        ("a: &a [*a]", "tried.yaml:1: a[0][0]"),
        ("[" * 600, "tried.yaml:1: not YAML: too large or too deep for a scenario"),
        (
            "a: !!python/name:os.system x",
            "tried.yaml:1: a: 'tag:yaml.org,2002:python/name:os.system' is no type",
        ),
        ("<<: {a: 1}", "tried.yaml:1: <<: a key must be a text"),
        (f"rate: {'9' * 5000}", "tried.yaml:1: rate: '999"),
    ],
)
def test_what_is_no_scenario_at_all_is_said_in_one_line(text, message):
    first, *_ = refusal(text)
    assert first.startswith(message)


@pytest.mark.parametrize("text", ["a: " + "[" * 2000, "a:\n" + "- 1\n" * 60_000], ids=["deep", "long"])
def test_a_text_is_read_up_to_the_value_that_is_too_much(text):
    (line,) = refusal(text + "\n@ no YAML")
    assert "too large or too deep for a scenario" in line


@pytest.mark.parametrize(
    ("file", "text", "command"),
    [
        ("a.yaml", "name: a\nscenario: mems_faults\nflights: 3\n", "campaign"),
        ("a.toml", "mass = 1.4\n", "check"),
    ],
)
def test_a_file_of_another_kind_is_told_by_the_command_that_takes_it(file, text, command, tmp_path):
    path = tmp_path / file
    path.write_text(text)
    with pytest.raises(ScenarioError, match=rf"{file}: .*: quadftc {command} {path}$"):
        load_scenario(path)


def test_a_large_file_is_not_read(tmp_path):
    path = tmp_path / "large.yaml"
    path.write_text("#" + "x" * 50_000_000)
    with pytest.raises(ScenarioError, match=f"^{re.escape(str(path))}: larger than 256 KiB"):
        read_document(path)


def test_aliases_of_aliases_do_not_fill_the_memory():
    laughs = "a0: &a0 [x, x]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]\n" for n in range(1, 40))
    (line,) = refusal(laughs)
    assert "too large or too deep for a scenario" in line


def test_all_mistakes_are_reported_in_the_order_of_the_file():
    text = (
        TEXT.replace("kind: step", "kind: stp").replace("rate: 250 Hz", "rate: 1").replace("2 deg/s", "2 kg")
    )
    assert [line.split(": ")[1] for line in refusal(text)] == [
        "rate",
        "references[0].kind",
        "faults[1].sigma",
    ]


def test_of_very_many_mistakes_ten_are_shown():
    lines = refusal(TEXT + "".join(f"key{n}: 1\n" for n in range(15)))
    assert len(lines) == 11
    assert lines[-1] == "tried.yaml: and 5 more"


def test_a_vehicle_file_is_found_beside_the_scenario(tmp_path, monkeypatch):
    source = Path(__file__).resolve().parents[2] / "quadftc_model/quadftc_model/vehicles/qball_x4.toml"
    (tmp_path / "mine.toml").write_text(source.read_text())
    (tmp_path / "tried.yaml").write_text(TEXT.replace("vehicle: qball_x4", "vehicle: mine.toml"))
    scenario = load_scenario(tmp_path / "tried.yaml")
    monkeypatch.chdir("/")
    assert scenario.vehicle == str(tmp_path / "mine.toml")
    assert simulator_from(node_parameters(scenario)["plant"]).plant.vehicle.name == "qball_x4"


def test_a_vehicle_file_on_the_command_line_is_found_where_one_stands(tmp_path, monkeypatch):
    source = Path(__file__).resolve().parents[2] / "quadftc_model/quadftc_model/vehicles/qball_x4.toml"
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "mine.toml").write_text(source.read_text())
    (tmp_path / "tried.yaml").write_text(TEXT)
    monkeypatch.chdir(tmp_path / "here")
    scenario = load_scenario(tmp_path / "tried.yaml", ["vehicle=mine.toml"])
    assert scenario.vehicle == str(tmp_path / "here" / "mine.toml")
    with pytest.raises(ScenarioError, match="No such file"):
        load_scenario(tmp_path / "tried.yaml", ["vehicle=other.toml"])


def test_scheme_is_labelled_by_the_components_that_differ():
    plain = parse_scenario(TEXT)
    (scheme, *_) = plain.schemes
    other = with_components(plain, controller="pid", observer=plain.schemes[scheme].observer.kind)
    label = label_of(other, scheme, plain)
    assert label == f"{scheme}-pid"
    named, flown = relabelled(other, scheme, label)
    assert (flown.name, flown.controller.kind) == (label, "pid")
    assert label in named.raw["schemes"]
    assert relabelled(plain, scheme, label_of(plain, scheme, plain))[1].name == scheme
    with pytest.raises(ScenarioError, match="expected letters"):
        relabelled(plain, scheme, "a b")


def test_a_motor_lag_that_is_too_fast_for_its_steps_is_refused():
    fast = ["plant.motor_lag=true", "plant.motor_bandwidth=500", "rate=200 Hz"]
    (line,) = refusal(TEXT, fast)
    assert "plant.substeps: 1: 500 rad/s of motor lag at 200 Hz need 2 at least" in line
    assert parse_scenario(TEXT, overrides=[*fast, "plant.substeps=2"]).plant.motor_time_constant == 0.002


def test_overrides_replace_and_add_values():
    scenario = parse_scenario(
        TEXT,
        overrides=[
            "faults.0.value=2 deg",
            "faults[1].axes=[y]",
            "plant.substeps=4",
            "schemes.plain.controller.k_d=0.2",
            "schemes.plain.observer=sliding_mode",
            "disturbances=[]",
        ],
    )
    assert scenario.faults[0].injection.law.value == (2.0 * DEG,) * 3
    assert scenario.faults[1].axes == ("pitch",)
    assert scenario.plant.substeps == 4
    assert scenario.schemes["plain"].controller.kind == "pid"
    assert scenario.schemes["plain"].controller.law.k_d == (0.2,) * 3
    assert scenario.schemes["plain"].observer.kind == "sliding_mode"
    assert scenario.disturbances == ()
    assert scenario.raw["faults"][0]["value"] == "2 deg"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("faults.0.value=2 dge", "tried.yaml: override 'faults.0.value=2 dge': faults[0].value: '2 dge'"),
        ("faults.2.value=2 deg", "no '2' in faults; there are: 0 to 1"),
        ("faults.first.value=2", "no 'first' in faults; there are: 0 to 1"),
        ("schemes.our.observer=none", "no scheme 'our' (did you mean 'ours'?); there are: ours, plain"),
        ("plnat.motor_lag=true", "plnat: unknown key (did you mean 'plant'?)"),
        ("plant.motor_leg=true", "plant.motor_leg: unknown key (did you mean 'motor_lag'?)"),
        ("rate.hz=2", "rate is a single value; it has no 'hz'"),
        ("rate", "expected path=value"),
        ("=3", "expected path=value"),
        ("faults..value=3", "expected path=value"),
        ("rate=[1", "not YAML"),
        ("rate=", "rate: None: expected a number in Hz"),
    ],
)
def test_a_wrong_override_is_refused(override, message):
    (line,) = refusal(TEXT, [override])
    assert line.startswith(f"tried.yaml: override {override!r}")
    assert message in line


def test_helpers_change_one_thing():
    scenario = parse_scenario(TEXT)
    assert with_rate(scenario, "1 kHz").rate == 1000.0
    assert with_seed(scenario, 3).seed == 3
    changed = with_components(with_components(scenario, observer="none"), "plain", controller="smc")
    assert [scheme.observer.kind for scheme in changed.schemes.values()] == ["none", "none"]
    assert [scheme.controller.kind for scheme in changed.schemes.values()] == ["ismc", "smc"]
    assert scenario.schemes["ours"].observer.kind == "sliding_mode"  # the original is as it was
    with pytest.raises(ScenarioError, match=r"observer non: .*did you mean 'none'"):
        with_components(scenario, "plain", observer="non")
    with pytest.raises(ScenarioError, match=r"no scheme 'plan'.*did you mean 'plain'"):
        with_components(scenario, "plan", controller="smc")


def test_the_beginning_of_a_scenario_has_what_starts_in_it():
    scenario = with_duration(parse_scenario(TEXT), 4.0)
    assert scenario.duration == 4.0
    assert [fault.injection.stop for fault in scenario.faults] == [math.inf, math.inf]
    assert scenario.fault_windows[0][:2] == (3.0, 4.0)
    assert with_duration(scenario, 2.5).faults == ()
    assert with_duration(scenario, 2.5).disturbances != ()


def test_scenarios_are_found_by_name_and_by_path(tmp_path, monkeypatch):
    (tmp_path / "mine.yaml").write_text(TEXT)
    monkeypatch.setenv("QUADFTC_SCENARIO_PATH", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert {"mine", "paper_faults"} <= set(scenario_names())
    assert load_scenario(find_scenario("mine")).name == "tried"
    assert find_scenario("paper_faults") == SHIPPED[0].parent / "paper_faults.yaml"
    assert find_scenario(str(tmp_path / "mine.yaml")) == tmp_path / "mine.yaml"
    with pytest.raises(ScenarioError, match=r"no scenario 'paper_fault' .did you mean 'paper_faults'"):
        find_scenario("paper_fault")
    with pytest.raises(ScenarioError, match=r"a directory; expected a file"):
        find_scenario(str(tmp_path))
    with pytest.raises(ScenarioError, match=r"yours\.yaml: no such file"):
        find_scenario("yours.yaml")
    with pytest.raises(ScenarioError, match="Is a directory"):
        load_scenario(tmp_path)
