"""Bad files and command lines: an exit code, a few lines, nothing outside the working folder.

With `--examples 4000` each kind is tried 500 times.
"""

from __future__ import annotations

import json
import re

import pytest
import yaml
from hypothesis import given, settings
from mcap.writer import CompressionType, Writer
from sampling import sampled

from attack.case import Case, try_case
from attack.seeds import CAMPAIGN, GAINS, SCENARIO, Seeds, with_vehicle
from attack.targets import TARGETS

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numbers that overflow on the way
EXAMPLES = settings().max_examples // 8


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    found = Seeds(tmp_path_factory.mktemp("seeds"))
    first, *others = found.scenarios
    # a check takes as long as there are samples
    found.scenarios = [first, *(text.replace(b"\nrate: 250 Hz", b"\nrate: 50 Hz") for text in others)]
    return found


@pytest.fixture(scope="module")
def sandbox(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz") / "sandbox"


@pytest.mark.parametrize("name", TARGETS)
def test_bad_input_is_answered_in_a_line_and_an_exit_code(name, seeds, sandbox):
    target = TARGETS[name]

    @settings(max_examples=EXAMPLES)
    @given(target.cases(seeds))
    def answered(case):
        outcome = try_case(case, target.program, sandbox)
        assert not outcome.wrong, (outcome.wrong, case.arguments, list(case.files))

    answered()


def test_command_lines_have_options_that_the_commands_declare(seeds):
    words = set()

    @settings(max_examples=100)
    @given(TARGETS["arguments"].cases(seeds))
    def draw(case):
        words.update(case.arguments)

    draw()
    assert words >= {"run", "check", "--out"}
    assert len({"--baseline", "--gains", "--isolability", "--observer", "--rate", "--set"} & words) > 1


def answer(sandbox, name, files, arguments):
    """What a target says of an input: exit code, and the lines of its errors."""
    outcome = try_case(Case(name, files, arguments), TARGETS[name].program, sandbox)
    assert not outcome.wrong
    return outcome.code, outcome.err.splitlines()


@pytest.mark.parametrize("name", TARGETS)
def test_good_input_is_not_refused(name, seeds, sandbox):
    """Else the inputs made of it would be refused for nothing."""
    bag = {f"bag/{file}": data for file, data in seeds.bag.items()}
    good = {
        "scenario": ({"s.yaml": SCENARIO}, ["check", "s.yaml"]),
        "flight": ({"s.yaml": SCENARIO}, ["s.yaml"]),
        "campaign": ({"c.yaml": CAMPAIGN, "tiny.yaml": SCENARIO, "gains.yaml": GAINS}, ["c.yaml"]),
        "gains": ({"s.yaml": SCENARIO, "g.yaml": GAINS}, ["check", "s.yaml", "--gains", "g.yaml"]),
        "set": ({"s.yaml": SCENARIO}, ["check", "s.yaml", "--set", "seed=4"]),
        "vehicle": (
            {"s.yaml": with_vehicle("v.toml"), "v.toml": seeds.vehicles[0]},
            ["check", "s.yaml", "--isolability"],
        ),
        "vehicle flown": ({"s.yaml": with_vehicle("v.toml"), "v.toml": seeds.vehicles[0]}, ["s.yaml"]),
        "ROS parameters": (
            {"p.yaml": seeds.parameters["controller"]},
            ["controller", "--ros-args", "--params-file", "p.yaml"],
        ),
        "bag": ({**bag, f"bag/{seeds.mcap}": seeds.loose}, ["check", "bag"]),
        "SQLite bag": ({f"bag/{file}": data for file, data in seeds.sqlite.items()}, ["replay", "bag"]),
        "faults overlaid": ({"log.ulg": seeds.ulog}, ["replay", "log.ulg", "--fault", "bias value=1deg"]),
        "arguments": ({"s.yaml": SCENARIO}, ["run", "s.yaml", "--rate", "100"]),
    }
    assert answer(sandbox, name, *good[name])[0] in (0, 1)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["report", "bag", "--out", "x" * 300], "File name too long"),
        (["run", "s.yaml", "--namespace", "3x"], "namespace = '3x': .*starts with a number"),
        (["run", "s.yaml", "--namespace", "\udcff"], "namespace = .*is no text"),
        (
            ["check", "s.yaml", "--set", f"faults.0.value={'x' * 5000}"],
            r"faults.0.value=x+ \[\.\.\.\] x+': expected|faults.0.value=x+\.\.\.x+': expected",
        ),
        (["run", "s.yaml", "--set", "name=../../x"], "name: '../../x': expected letters, digits"),
        (["run", "s.yaml", "--set", "schemes.proposed.controller=../x"], "no controller"),
        (["check", "s.yaml", "--set", "references.1.rise=1e308"], r"rise: 1e\+308 s: must be within"),
        (["check", "s.yaml", "--set", "references.0.frequency=1e308"], r"frequency: 1e\+308 rad/s: must"),
    ],
)
def test_argument_that_once_crashed_is_refused(seeds, sandbox, arguments, words):
    files = {"s.yaml": SCENARIO, **{f"bag/{file}": data for file, data in seeds.bag.items()}}
    code, lines = answer(sandbox, "arguments", files, arguments)
    assert code == 2
    assert re.search(words, lines[0])
    assert max(map(len, lines)) < 1300


DEEP = [b"[" * 5_000, b"{a: " * 5_000, b"a: &a [*a]\n", b"- " * 3_000]
BESIDE = ["parameters.yaml", "metadata.yaml", "scenario.yaml"]


@pytest.mark.parametrize(
    ("text", "file", "command"), sampled(DEEP, BESIDE, ["check", "replay", "repair"], every=11)
)
def test_deep_yaml_beside_a_bag_is_no_crash(seeds, sandbox, command, file, text):
    files = {f"bag/{name}": data for name, data in seeds.bag.items()}
    files |= {f"bag/{seeds.mcap}": seeds.loose, f"bag/{file}": text}
    answer(
        sandbox, "bag", files, [command, "bag", "--out", "out"] if command != "check" else [command, "bag"]
    )


@pytest.mark.parametrize("late", [2**63, 2**64 - 1])
@pytest.mark.parametrize("command", ["check", "replay", "repair", "report"])
def test_bag_with_a_time_that_is_none_is_read_up_to_there(seeds, sandbox, tmp_path, command, late):
    with (tmp_path / "late.mcap").open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE, use_chunking=False, enable_crcs=False)
        writer.start(profile="ros2")
        text = (
            b"builtin_interfaces/Time a\n"
            + b"=" * 80
            + b"\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
        )
        schema = writer.register_schema("x_msgs/msg/X", "ros2msg", text)
        channel = writer.register_channel("/x", "cdr", schema)
        for time in (1, 2, late):
            writer.add_message(channel, time, b"\0\1\0\0" + bytes(8), time)
        writer.finish()
    files = {"late.mcap": (tmp_path / "late.mcap").read_bytes()}
    code, _ = answer(sandbox, "bag", files, [command, "late.mcap"])
    assert code == (0 if command == "repair" else 2)


def test_parameters_beside_a_bag_whose_names_are_numbers_make_no_sense(seeds, sandbox):
    files = {f"bag/{name}": data for name, data in seeds.bag.items()}
    files |= {
        f"bag/{seeds.mcap}": seeds.loose,
        "bag/parameters.yaml": b"/fault_observer:\n  ros__parameters: {1.5: 2.0}\n",
    }
    code, lines = answer(sandbox, "bag", files, ["replay", "bag", "--out", "out"])
    assert (code, "parameters.yaml makes no sense" in lines[0]) == (2, True)


def test_summary_with_a_number_beyond_all_floats_disagrees(seeds, sandbox):
    files = {f"bag/{name}": data for name, data in seeds.bag.items()}
    summary = json.loads(files["bag/summary.json"])
    summary["metrics"]["tracking_rmse_deg"]["roll"] = 10**400
    files["bag/summary.json"] = json.dumps(summary).encode()
    answer(sandbox, "bag", files, ["check", "bag"])


def test_bag_whose_topics_are_numbers_is_refused(seeds, sandbox):
    files = {f"bag/{name}": data for name, data in seeds.sqlite.items()}
    files["bag/metadata.yaml"] = files["bag/metadata.yaml"].replace(b"name: /imu/data", b"name: 1.5")
    code, lines = answer(sandbox, "SQLite bag", files, ["replay", "bag", "--out", "out"])
    assert (code, "topic 1.5: expected a name" in lines[0]) == (2, True)


@pytest.mark.parametrize("number", ["1e300", "1e-320", "nan", "9" * 400])
@pytest.mark.parametrize("key", ["mass", "thrust_gain", "time_constant"])
def test_vehicle_with_an_absurd_number_is_refused_by_its_key(seeds, sandbox, key, number):
    text = re.sub(rf"(?m)^{key} = \S+", f"{key} = {number}", seeds.vehicles[0].decode())
    files = {"s.yaml": with_vehicle("v.toml"), "v.toml": text.encode()}
    code, lines = answer(sandbox, "vehicle", files, ["check", "s.yaml"])
    assert code == 2
    assert re.search(rf"v\.toml:\d+: (rotors\.)?{key} = ", lines[0]), lines


@pytest.mark.parametrize("value", ["\ud800", "a\rb", "\u202e", "[/]", "%s"])
def test_texts_that_terminals_trip_over_are_shown(sandbox, value):
    data = {**yaml.safe_load(SCENARIO), "vehicle": value}
    text = yaml.safe_dump(data)
    assert answer(sandbox, "scenario", {"s.yaml": text.encode()}, ["check", "s.yaml"])[0] == 2
