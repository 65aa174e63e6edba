# pyright: basic
"""Tuning: where the search goes and where it may not go, what is refused, what is written."""

import numpy as np
import pytest

from quadftc_campaign.campaign_file import load_campaign
from quadftc_campaign.errors import CampaignError
from quadftc_campaign.tune.sensitivity import Sensitivity, directions, gains_of, with_gains
from quadftc_campaign.tune.tuning import Search, checked, tune, write
from quadftc_cli.main import guarded
from quadftc_flight.scenario import ScenarioError, load_scenario

BASE = """
duration: 0.5 s
rate: 250 Hz
vehicle: qball_x4
sensors: {grade: mems, gyro_bias: 0}
references:
  - {kind: sine, amplitude: 5 deg, frequency: 3, start: 0.1 s}
schemes:
  plain: {disturbance_observer: exosystem, controller: {kind: ismc, k_c1: [4, 16, 9], k_c2: [2, 8, 6]}}
  other: {controller: ismc}
"""
CAMPAIGN = """
name: short
scenario: base.yaml
flights: 8
seed: 3
schemes: [plain]
vary:
  references.0.amplitude: {uniform: [3 deg, 6 deg], size: 3}
tune:
  gains: [controller.k_c1, controller.k_c2]
  cost: {tracking_rmse_deg: 1, torque_total_variation: 0.2}
  flights: 4
  steps: 5
  rate: 0.2
  held_out: 8
"""
QUIET = np.log(6.0)  # where the made-up cost is least


def loaded(tmp_path, text=CAMPAIGN):
    (tmp_path / "base.yaml").write_text(BASE)
    path = tmp_path / "campaign.yaml"
    path.write_text(text)
    return load_campaign(path)


def made_up(campaign, gains, numbers):
    """Metrics of which the first, on roll, is 1 plus the squared distance of the first gain to 6."""
    distance = gains.logarithms[0] - QUIET
    values = np.ones((len(numbers), 2, 3))
    values[:, 0, 0] += distance**2
    slopes = np.zeros((len(numbers), len(gains.logarithms), 2, 3))
    slopes[:, 0, 0, 0] = 2.0 * distance
    return Sensitivity(values, slopes)


def searched(campaign, fly=made_up, **changes):
    campaign = campaign.model_copy(update={"tune": campaign.tune.model_copy(update=changes)})
    search = Search(campaign, checked(campaign), fly)
    return search, list(search.steps())


def test_the_search_goes_where_the_cost_is_least(tmp_path):
    search, steps = searched(loaded(tmp_path), steps=60, rate=0.06)
    (start, first_cost), *_, (_, last_cost) = steps
    assert first_cost == pytest.approx(1.0)
    assert last_cost < first_cost
    first, *others = search.result.logarithms
    assert first == pytest.approx(QUIET, abs=0.02)
    np.testing.assert_allclose(others, start.logarithms[1:], atol=1e-3)  # but for rounding


def test_the_search_stays_where_the_theory_holds(tmp_path):
    """k_c3 may not fall below what Theorem 2 asks for, however cheap that would be."""
    text = CAMPAIGN.replace("[controller.k_c1, controller.k_c2]", "[controller.k_c3]")
    campaign = loaded(
        tmp_path,
        text.replace(
            "flights: 8",
            "flights: 8\nset: ['disturbances=[{kind: sine, amplitude: 0.02 N m, frequency: 1}]']",
        ),
    )

    def downhill(with_them, gains, numbers):
        found = made_up(with_them, gains, numbers)
        found.slopes[:] = 1.0
        return found

    search, _ = searched(campaign, downhill, steps=15, rate=0.5)
    assert not search.failing
    scheme = campaign.variants[0].scheme
    assert not search._failing(search.result)
    lower = search.result.at(search.result.logarithms - 0.3)
    assert any("Theorem 2" in name for name in search._failing(lower)), scheme


def test_flights_that_crash_are_an_error_at_the_start_and_a_wall_later(tmp_path):
    def crashing(beyond):
        def fly(with_them, gains, numbers):
            found = made_up(with_them, gains, numbers)
            if gains.logarithms[0] > beyond:
                found.values[0, 0, 0] = np.nan
            return found

        return fly

    with pytest.raises(CampaignError, match="flights crash with"):
        searched(loaded(tmp_path), crashing(-1.0))
    search, _ = searched(loaded(tmp_path), crashing(np.log(5.0)), steps=30, rate=0.1)
    assert np.log(4.0) < search.result.logarithms[0] <= np.log(5.0) + 1e-3


def test_directions_are_those_of_what_is_built(tmp_path):
    """The logarithm of a gain moves the gain by its size."""
    campaign = loaded(tmp_path)
    gains = checked(campaign)
    ways = directions(campaign, campaign.variants[0], gains, 0)
    gain, other = (f"loop.attitude.law.controller.{name}" for name in ("k_c1", "k_c2"))
    assert ways[gain].shape == (6, 3)
    np.testing.assert_allclose(ways[gain][1], [0.0, 16.0, 0.0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(ways[other][5], [0.0, 0.0, 6.0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "controller.k_c1, ",
            "controller.k_c9, ",
            "ismc has no such number; there are: k_c1, k_c2, k_c3, phi",
        ),
        ("controller.k_c1, ", "engine.k, ", "expected role.parameter"),
        ("controller.k_c1, ", "observer.delta, ", "none has no such number; there are: none"),
        ("controller.k_c1, ", "controller.k_c2, ", "given twice"),
        ("tracking_rmse_deg: 1", "tracking_rmse: 1", "no 'tracking_rmse'; there are: tracking_rmse_deg"),
        ("tracking_rmse_deg: 1", "tracking_rmse_deg: -1", "must be positive"),
        ("steps: 5", "steps: 0", "steps"),
        ("schemes: [plain]", "schemes: [plain, other]", "one scheme is tuned"),
        ("tune:", "report: {}\nx_tune:", "unknown key"),
        (CAMPAIGN[CAMPAIGN.index("tune:") :], "", "no key 'tune'"),
        ("controller.k_c1, ", "position_controller.k_p, ", "expected role.parameter"),
    ],
)
def test_what_cannot_be_tuned_is_refused(tmp_path, old, new, message):
    with pytest.raises((CampaignError, ScenarioError), match=message):
        checked(loaded(tmp_path, CAMPAIGN.replace(old, new, 1)))


def test_a_gain_of_zero_is_refused(tmp_path):
    campaign = loaded(
        tmp_path, CAMPAIGN.replace("flights: 8", "flights: 8\nset: ['schemes.plain.controller.k_c1=0']")
    )
    with pytest.raises(ScenarioError, match="must be positive to be tuned"):
        checked(campaign)


@pytest.mark.thorough
def test_tuned_gains_fly_better_and_can_be_used(tmp_path, capsys):
    """A roll axis four times too soft, through gradients of real flights, to a file and into a scenario."""
    campaign = loaded(tmp_path)
    told = []
    found = tune(campaign, 1, told.append)
    assert len(told) == 5
    assert found.after.cost < 0.8 * found.before.cost
    assert found.after.crashed == 0
    path = tmp_path / "gains" / "short.yaml"
    write(found, campaign, path)
    tuned = load_scenario(tmp_path / "base.yaml", gains=str(path))
    for name in ("plain", "other"):  # every scheme with such a controller
        law = tuned.scheme(name).controller.law
        assert list(law.k_c1) == found.gains.plain()["controller.k_c1"]
    assert gains_of(with_gains(campaign, "plain", found.gains), tuned.scheme("plain"), found.gains.names)
    other = (tmp_path / "base.yaml").read_text().replace("qball_x4", "crazyflie_2x")
    (tmp_path / "other.yaml").write_text(other)
    both = load_scenario(tmp_path / "base.yaml", ["schemes.plain.controller.k_c2=7"], str(path))
    assert both.scheme("plain").controller.law.k_c2 == (7.0, 7.0, 7.0)  # an override comes last
    with pytest.raises(ScenarioError, match=r"vehicle: 'qball_x4': .*other\.yaml has 'crazyflie_2x'"):
        load_scenario(tmp_path / "other.yaml", gains=str(path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("vehicle: qball_x4\n", "grade"),
        ("vehicle: qball_x4\ngrade: ideal\ncontroller: {kind: ismc}\n", "'ideal': .* has 'mems'"),
        (
            "vehicle: qball_x4\ngrade: mems\ncontroller: {kind: smc, phi: 0.2}\n",
            "no scheme of .* part of these kinds",
        ),
        ("vehicle: qball_x4\ngrade: mems\ncontroller: {kind: ismc, k: 1}\n", "controller.k: unknown key"),
        ("vehicle: qball_x4\ngrade: mems\ncontroller: {k_c1: 1}\n", "kind"),
        ("vehicle: qball_x4\ngrade: mems\nengine: {kind: ismc}\n", "engine: unknown key"),
    ],
)
def test_a_file_of_gains_that_is_wrong_is_refused(tmp_path, text, message):
    (tmp_path / "base.yaml").write_text(BASE)
    (tmp_path / "gains.yaml").write_text(text)
    with pytest.raises(ScenarioError, match=message):
        load_scenario(tmp_path / "base.yaml", gains=str(tmp_path / "gains.yaml"))


def test_gains_that_are_not_there_are_said_in_one_line(capsys):
    assert guarded(["check", "mems_faults", "--gains", "nowhere"]) == 2
    assert "no gains 'nowhere'" in capsys.readouterr().err
