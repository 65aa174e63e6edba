"""What all tests share: a ROS domain of their own, on this machine only, and a bench for nodes."""

from __future__ import annotations

import fcntl
import gc
import os
import re
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import pytest
from hypothesis import settings

# property tests: the same examples in every run, and no time limit for one
settings.register_profile("thorough", derandomize=True, database=None, deadline=None)
settings.register_profile("usual", settings.get_profile("thorough"), max_examples=40)

DOMAINS = range(1, 81)  # of those that ROS 2 can have on any Linux

# Compiling took most of the tests' time, and the flights are short. The last two flags halve it again.
QUICK_TO_COMPILE = (
    "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
    " --xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
)

# Tests that must not run beside others: by the wall clock, with signals, of processes that await each other.
# So are all on a bench in real time.
SERIAL_FILES = {
    "test_bag_writer.py",
    "test_bench.py",
    "test_children.py",
    "test_executor.py",
    "test_graph_realtime.py",
    "test_launch_file.py",
    "test_launch_graph.py",
    "test_recorder_faults.py",
    "test_recorder_node.py",
    "test_software_faults.py",
}
SERIAL_FIXTURES = {"bench"}

# Tests that take seconds each. `scripts/test --quick` and `colcon test` leave them out.
SLOW_FILES = {
    "test_allocation.py",
    "test_any_attitude.py",
    "test_ardupilot.py",
    "test_ardupilot_flight.py",
    "test_attack_files.py",
    "test_attack_logs.py",
    "test_attack_pages.py",
    "test_attack_stops.py",
    "test_attitude_loop.py",
    "test_bad_messages.py",
    "test_bad_parameters.py",
    "test_bag_repair.py",
    "test_bags.py",
    "test_bank_inference.py",
    "test_bank_noise.py",
    "test_bank_observer.py",
    "test_bank_trust.py",
    "test_batch_engine.py",
    "test_batch_free_flight.py",
    "test_c_equals_numpy.py",
    "test_campaign.py",
    "test_campaign_report.py",
    "test_carry.py",
    "test_check.py",
    "test_check_command.py",
    "test_cli.py",
    "test_clock_jumps.py",
    "test_closed_loop.py",
    "test_coasting.py",
    "test_conditions.py",
    "test_controller_contract.py",
    "test_diagnose_command.py",
    "test_diagnose_log.py",
    "test_diagnose_response.py",
    "test_diagnose_slow_log.py",
    "test_emit.py",
    "test_endurance.py",
    "test_engine.py",
    "test_examples.py",
    "test_executables.py",
    "test_exosystem.py",
    "test_export.py",
    "test_export_command.py",
    "test_export_emulated.py",
    "test_fault_observer_contract.py",
    "test_free_flight.py",
    "test_golden_logs.py",
    "test_golden_observers.py",
    "test_graph_lockstep.py",
    "test_guidance.py",
    "test_handover.py",
    "test_heading.py",
    "test_inertial_filter.py",
    "test_isolability.py",
    "test_isolating.py",
    "test_isolating_in_flight.py",
    "test_laws.py",
    "test_live_bag.py",
    "test_live_page.py",
    "test_loop_run.py",
    "test_observers_with_rotors.py",
    "test_open_loop.py",
    "test_page_access.py",
    "test_plant.py",
    "test_position_controller_contract.py",
    "test_position_estimator.py",
    "test_px4.py",
    "test_readers.py",
    "test_readers_packed.py",
    "test_readers_ros1.py",
    "test_release.py",
    "test_replay_command.py",
    "test_replay_directory.py",
    "test_replay_log.py",
    "test_replay_ulog.py",
    "test_report_command.py",
    "test_report_drawing.py",
    "test_report_in_browser.py",
    "test_report_page.py",
    "test_report_replays.py",
    "test_rigid_body_references.py",
    "test_rotor_diagnosis.py",
    "test_rotor_off.py",
    "test_sensors.py",
    "test_serve_command.py",
    "test_sitl.py",
    "test_slopes.py",
    "test_stretches.py",
    "test_study_false_alarms.py",
    "test_supervised.py",
    "test_supervision.py",
    "test_theory_control.py",
    "test_theory_indi.py",
    "test_tune.py",
    "test_winds.py",
}


def _own_domain() -> IO[str]:
    """Claim a ROS domain that no other test session on this machine has, as long as the file is open."""
    for domain in DOMAINS:
        file = Path(tempfile.gettempdir(), f"quadftc_test_domain_{domain}.lock").open("w")  # noqa: SIM115
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            file.close()
            continue
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        return file
    raise RuntimeError("no ROS domain is free: too many test sessions at a time")


def pytest_configure(config: pytest.Config) -> None:
    """Before anything of ROS or NumPy is imported; in every worker of pytest-xdist, too."""
    for library in ("OPENBLAS", "OMP"):  # with small matrices, threads do little but wait for each other
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    os.environ.setdefault("XLA_FLAGS", QUICK_TO_COMPILE)
    os.environ.setdefault("NPROC", "1")  # so many threads has JAX
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = ""
    from quadftc_ros.leftovers import remove_leftovers  # pure
    from quadftc_ros.reach import stay_local  # pure

    stay_local()
    if not hasattr(config, "workerinput"):
        remove_leftovers()
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # in a background job; its children ignore it, too
        signal.signal(signal.SIGINT, signal.default_int_handler)
    gc.set_threshold(100_000, 20, 100)  # the usual ones cost a tenth of the time: JAX keeps many objects
    config.stash[DOMAIN_LOCK] = _own_domain()
    if examples := config.getoption("--examples"):
        settings.register_profile("asked", settings.get_profile("thorough"), max_examples=examples)
    usual = "thorough" if config.getoption("--thorough") else "usual"
    settings.load_profile("asked" if examples else usual)


DOMAIN_LOCK = pytest.StashKey[IO[str]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let everything be asked for."""
    parser.addoption("--thorough", action="store_true", help="run the tests marked thorough, too")
    parser.addoption("--examples", type=int, help="of each property test")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Do not even import files of which -m would leave all tests out."""
    chosen, name = config.getoption("markexpr"), collection_path.name
    left_out = (name in SLOW_FILES and "not slow" in chosen) or (
        name in SERIAL_FILES and "not serial" in chosen
    )
    if chosen == "serial" and name.startswith("test_") and name not in SERIAL_FILES:
        left_out = not re.search(r"\bbench\b|\bserial\b", collection_path.read_text(encoding="utf-8"))
    return left_out or None


@pytest.hookimpl(tryfirst=True)  # before -m chooses
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark tests that must not run beside others, and slow ones, which come first; leave out the thorough.

    `colcon test`, which alone names a package in its report, leaves out the slow ones, too.
    """
    for item in items:
        if not isinstance(item, pytest.Function):
            continue
        if item.path.name in SERIAL_FILES or SERIAL_FIXTURES & set(item.fixturenames):
            item.add_marker(pytest.mark.serial)
        if item.path.name in SLOW_FILES:
            item.add_marker(pytest.mark.slow)
    if not config.getoption("--thorough"):
        left_out = ("thorough", "slow") if config.getoption("junitprefix") else ("thorough",)
        items[:] = [item for item in items if not any(map(item.get_closest_marker, left_out))]
    items.sort(key=lambda item: item.path.name not in SLOW_FILES)  # so that no worker is idle at the end


def pytest_collection_finish() -> None:
    """Spare the garbage collection what was imported."""
    gc.freeze()


@pytest.fixture
def bench() -> Iterator[Any]:
    """A bench for nodes in real time, see `node_bench`."""
    from node_bench import NodeBench

    with NodeBench("realtime") as made:
        yield made


@pytest.fixture
def lockstep_bench() -> Iterator[Any]:
    """A bench for nodes in lock-step."""
    from node_bench import NodeBench

    with NodeBench("lockstep") as made:
        yield made
