"""Hypotheses of the observer bank: equal to a second Kalman filter that knows the fault; and their onsets."""

import numpy as np
import pytest

from quadftc_fdi.bank import hypotheses, inference, modes, motion
from quadftc_fdi.bank.hypotheses import FIRST, OF_ATTITUDE, OF_GYRO, SLOTS, SPACING
from quadftc_fdi.bank.motion import BETA, OMEGA, THETA, D
from quadftc_fdi.bank.noise import LONGER, Noise
from quadftc_model.rotations import earth_z_in_body, quaternion_from_euler, rotation_between, turn
from quadftc_model.samples import STANDARD_GRAVITY

DT, ONSET, END, ROWS, SLOT = 0.01, 30, 70, 90, 0  # s; the slot that the first onset takes
NOISE = Noise(*(np.full(3, std_dev**2) for std_dev in (0.02, 1.5, 0.01, 0.005, 0.03)))
SIZE, SWAY = slice(4, 6), 6  # states of the second filter: after those of the motion
WALK, AXIS = 0.02, 0  # rad/s/sqrt(s)
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
RARER = -9.0  # log of odds
THERE, NONE = np.ones(3, bool), np.zeros(3, bool)
RETURNS = (modes.RETURN, modes.GYRO_RETURN)
BLIND = 0.4 * np.sin(0.05 * np.arange(ROWS))  # rad/s, rad; what a sensor of a wrong scale should read
OF_SCALE = {modes.GYRO: modes.SCALED, modes.ATTITUDE: modes.STRETCHED}
ALIKE = np.zeros((modes.MODES, sum(SLOTS)))  # log weight


def readings(kind, size, slope, repeats_gyro, end=ROWS):
    """Known acceleration, gyro and angle (ROWS,) of one axis with a fault from `ONSET` to a row."""
    rng = np.random.default_rng(3)
    known = 0.5 * np.sin(np.arange(ROWS))
    elapsed = (np.arange(ROWS) - ONSET) * DT
    fault = np.where((elapsed >= 0.0) & (np.arange(ROWS) < end), size + slope * elapsed, 0.0)
    pushed = np.where(elapsed > 0.0, size, 0.0) * (kind == modes.PUSH)
    rate = np.cumsum(known + pushed) * DT
    gyro = rate + 0.02 * rng.standard_normal(ROWS) + fault * (kind == modes.GYRO)
    gyro = gyro + fault * BLIND * (kind == modes.SCALED)
    told = gyro if repeats_gyro else rate
    angle = np.cumsum(told) * DT + 0.01 * rng.standard_normal(ROWS) + fault * (kind == modes.ATTITUDE)
    return known, gyro, angle + fault * BLIND * (kind == modes.STRETCHED)


class SecondFilter:
    """Kalman filter of one axis by the equations of `bank.motion`; it has size and slope as states, too."""

    def __init__(self, P, kind):
        self.x, self.P, self.kind, self.log_likelihood = np.zeros(7), np.zeros((7, 7)), kind, 0.0
        self.P[SWAY, SWAY] = NOISE.sway[0]
        self.P[:4, :4] = P
        self.age = -1.0

    def begin(self, prior):
        self.age = 0.0
        self.P[SIZE, SIZE] = np.diag(prior)
        if self.kind == modes.PUSH:
            self.move(np.eye(7) + np.outer(np.eye(7)[D], np.eye(7)[4]))

    def move(self, F, driven=0.0, Q=0.0):
        self.x, self.P = F @ self.x + driven, F @ self.P @ F.T + Q

    def predict(self, known, gyro, repeats_gyro):
        F, keep, driven = np.eye(7), np.exp(-DT / motion.CORRELATED), np.zeros(7)
        F[OMEGA, D], F[D, D], driven[OMEGA] = DT, keep, DT * known
        if repeats_gyro:
            F[THETA, BETA], driven[THETA] = -DT, DT * gyro
        else:
            F[THETA, [OMEGA, D]], driven[THETA] = (DT, 0.5 * DT**2), 0.5 * DT**2 * known
        F[SWAY, SWAY] = fades = np.exp(-DT / LONGER)
        drive, sways = NOISE.unknown[0] * (1.0 - keep**2), NOISE.sway[0] * (1.0 - fades**2)
        Q = np.diag([NOISE.wander[0] * DT, WALK**2 * DT, drive * DT**2 / 3.0, drive, 0.0, 0.0, sways])
        self.move(F, driven, Q)
        self.age += DT if self.age >= 0.0 else 0.0

    def measure(self, H, reading, variance, sensor, scaled=0.0):
        if self.age >= 0.0 and self.kind == sensor:
            H = H + np.array([0.0, 0.0, 0.0, 0.0, 1.0, self.age, 0.0])
        if self.age >= 0.0 and self.kind == OF_SCALE[sensor]:
            H = H + scaled * np.eye(7)[4]
        e, V = reading - H @ self.x, H @ self.P @ H + variance
        self.log_likelihood -= 0.5 * (e * e / V + np.log(V))
        K = self.P @ H / V
        self.x, self.P = self.x + K * e, self.P - np.outer(K, H @ self.P)


def without_sensor_errors(state):
    """A motion whose scale and lag are known: then all is linear."""
    states = np.arange(motion.STATES)
    known = (states < motion.SCALE.start) | (states == motion.SWAY)
    return state._replace(covariance=state.covariance * known[:, None] * known)


def fly_bank(known, gyro, angle, repeats_gyro, *onsets):
    """Motion and bank after all readings, ``onsets`` taken at these rows."""
    e = np.eye(3)[AXIS]
    state = without_sensor_errors(motion.start_motion(LEVEL, np.zeros(3), NOISE))
    bank = hypotheses.start_bank(np.zeros(3))
    bank = bank._replace(temper=np.ones_like(bank.temper))
    for row in range(ROWS):
        mean = gyro[row] * e
        given = known[row] * e, np.zeros(3), np.True_, mean, np.full(3, WALK), NOISE, repeats_gyro, DT
        state = motion.predict(state, *given)
        bank = hypotheses.move(bank, state.rate, repeats_gyro, DT)
        bank = one_onset(bank, row in onsets)
        state, bank = measure(state, bank, mean, turn(LEVEL, angle[row] * e), BLIND[row] * e)
    return state, bank


def believed_of(bank, good_attitude=THERE, failing=NONE):
    return inference.believe(bank, good_attitude, good_attitude, np.True_, failing, RARER)


def by_size_and_slope(bank, mode, slot):
    """U of a mode on its own axis (4, 2); no slope is none."""
    U = bank.U[:4, AXIS, :, slot]
    return np.column_stack([U[:, mode], U[:, modes.EFFECTS + mode] if mode < modes.SLOPES else 0.0 * U[:, 0]])


def one_onset(bank, now):
    """Let all hypotheses grow older; begin an onset in each ring, or in none."""
    bank = bank._replace(since=np.array(SPACING) if now else np.full(len(SLOTS), -1.0))
    return hypotheses.open_slots(bank, ALIKE, NONE, np.True_, DT)


def measure(state, bank, gyro, q_xyzw, blind=LEVEL[:3]):
    """Take a reading of the gyro and one of the attitude, near level: faults turn about body axes."""
    S = hypotheses.of_gyro(bank, state.rate, blind)
    state, seen = motion.take_gyro(state, gyro, NOISE.gyro, THERE)
    bank = hypotheses.weigh(bank, OF_GYRO, seen, S)
    added = modes.pattern(modes.ATTITUDE) + blind[:, None] * modes.pattern(modes.STRETCHED)
    S = hypotheses.of_attitude(bank, state.rate, added)
    state, seen = motion.take_attitude(state, q_xyzw, NOISE.attitude, THERE)
    return state, hypotheses.weigh(bank, OF_ATTITUDE, seen, S)


@pytest.mark.parametrize("repeats_gyro", [False, True])
@pytest.mark.parametrize(
    ("kind", "size", "slope"),
    [
        (modes.ATTITUDE, 0.03, 0.02),
        (modes.GYRO, -0.1, 0.1),
        (modes.PUSH, 4.0, 0.0),
        (modes.SCALED, 0.5, 0.0),
        (modes.STRETCHED, 0.1, 0.0),
    ],
)
def test_a_hypothesis_is_a_filter_that_knows_the_fault(kind, size, slope, repeats_gyro, monkeypatch):
    """Separate-bias theorem: state, covariance and likelihood ratio are those of the larger filter."""
    monkeypatch.setattr(motion, "SMEAR", 0.0)  # noise that grows with the rate is not linear
    monkeypatch.setattr(motion, "JITTER", 0.0)
    known, gyro, angle = readings(kind, size, slope, repeats_gyro)
    state, bank = fly_bank(known, gyro, angle, repeats_gyro, ONSET)
    believed = believed_of(bank._replace(square=0.0 * bank.square))  # nothing is left unexplained
    start = motion.start_motion(LEVEL, np.zeros(3), NOISE).covariance[AXIS, :4, :4]
    mode = 3 * kind + AXIS
    knows, healthy = SecondFilter(start, kind), SecondFilter(start, None)
    for row in range(ROWS):
        for each in (knows, healthy):
            each.predict(known[row], gyro[row], repeats_gyro)
            if row == ONSET and each is knows:
                each.begin(modes.PRIOR[mode])
            by_gyro = np.eye(7)[BETA] + np.eye(7)[OMEGA]
            each.measure(by_gyro, gyro[row], NOISE.gyro[0], modes.GYRO, BLIND[row])
            each.measure(
                np.eye(7)[THETA] + np.eye(7)[SWAY], angle[row], NOISE.attitude[0], modes.ATTITUDE, BLIND[row]
            )
    assert not state.loud.any()  # no reading was taken for a loud one
    evidence = believed.log_weight[mode, SLOT] - hypotheses.USUAL[mode, SLOT]
    assert evidence == pytest.approx(knows.log_likelihood - healthy.log_likelihood, rel=1e-6)
    assert evidence > 3.0 or repeats_gyro  # it was seen; an attitude that repeats a gyro's fault hides it
    b, U = believed.b[:, mode, SLOT], by_size_and_slope(bank, mode, SLOT)
    assert b == pytest.approx(knows.x[SIZE], rel=1e-6, abs=1e-9)
    angle_now = 2.0 * np.arctan2(state.q_xyzw[AXIS], state.q_xyzw[3])
    x = np.array([angle_now, state.bias[AXIS], state.rate[AXIS], state.unknown[AXIS]])
    assert x + U @ b == pytest.approx(knows.x[:4], rel=1e-6, abs=1e-8)
    first, mixed, last = believed.covariance[:, mode, SLOT]
    spread = np.array([[first, mixed], [mixed, last]])
    assert spread == pytest.approx(knows.P[SIZE, SIZE], rel=1e-6)
    P = state.covariance[AXIS, :4, :4] + U @ spread @ U.T
    assert pytest.approx(knows.P[:4, :4], rel=1e-6, abs=1e-12) == P


@pytest.mark.parametrize(
    ("kind", "ended", "size", "slope", "repeats_gyro"),
    [
        (modes.RETURN, modes.ATTITUDE, 0.03, 0.02, False),
        (modes.RETURN, modes.ATTITUDE, 0.03, 0.02, True),
        (modes.GYRO_RETURN, modes.GYRO, -0.1, 0.1, False),
    ],
)
def test_a_return_is_a_filter_that_knows_when_the_fault_began_and_ended(
    kind, ended, size, slope, repeats_gyro, monkeypatch
):
    monkeypatch.setattr(motion, "SMEAR", 0.0)
    monkeypatch.setattr(motion, "JITTER", 0.0)
    known, gyro, angle = readings(ended, size, slope, repeats_gyro, END)
    state, bank = fly_bank(known, gyro, angle, repeats_gyro, ONSET, END)
    believed = believed_of(bank._replace(square=0.0 * bank.square))
    mode, slot = 3 * kind + AXIS, SLOT + 1
    start = motion.start_motion(LEVEL, np.zeros(3), NOISE).covariance[AXIS, :4, :4]
    knows, healthy = SecondFilter(start, ended), SecondFilter(start, None)
    for row in range(ROWS):
        for each in (knows, healthy):
            each.predict(known[row], gyro[row], repeats_gyro)
            if row == ONSET and each is knows:
                each.begin(modes.PRIOR[mode])
            if row == END:
                each.kind = None
            each.measure(np.eye(7)[BETA] + np.eye(7)[OMEGA], gyro[row], NOISE.gyro[0], modes.GYRO)
            each.measure(np.eye(7)[THETA] + np.eye(7)[SWAY], angle[row], NOISE.attitude[0], modes.ATTITUDE)
    assert not state.loud.any()
    # four slots hold that fault, alike; the end comes at the rate of events
    began = hypotheses.USUAL[3 * ended + AXIS, [FIRST[ring] for ring in range(len(SLOTS))]].mean()
    evidence = believed.log_weight[mode, slot] - began - np.log(modes.EVENTS / 3600.0 * SPACING[0])
    assert evidence == pytest.approx(knows.log_likelihood - healthy.log_likelihood, rel=1e-6)
    assert evidence > believed.log_weight[3 * ended + AXIS].max()
    assert believed.b[:, mode, slot] == pytest.approx(knows.x[SIZE], rel=1e-6, abs=1e-9)
    b, U = believed.b[:, mode, slot], by_size_and_slope(bank, mode, slot)
    angle_now = 2.0 * np.arctan2(state.q_xyzw[AXIS], state.q_xyzw[3])
    x = np.array([angle_now, state.bias[AXIS], state.rate[AXIS], state.unknown[AXIS]])
    assert x + U @ b == pytest.approx(knows.x[:4], rel=1e-6, abs=1e-8)


def test_what_a_fault_has_taught_since_its_onset_does_not_excuse_it():
    flown = [np.ones(2), np.array([1.0, 4.0])]  # temper before and from the onset on
    seen = motion.Gains(np.ones(3), np.ones(3), np.zeros((3, motion.STATES)), THERE)
    S = np.ones((3, len(modes.COLUMN), sum(SLOTS)))
    told = []
    for before, since in flown:
        bank = one_onset(hypotheses.start_bank(np.zeros(3)), now=False)
        bank = one_onset(bank._replace(temper=np.full_like(bank.temper, before)), now=True)
        bank = bank._replace(temper=np.full_like(bank.temper, since))
        told.append(hypotheses.weigh(bank, OF_ATTITUDE, seen, S))
    np.testing.assert_array_equal(*(each.J[OF_ATTITUDE][..., SLOT] for each in told))
    assert told[0].J[OF_ATTITUDE][..., SLOT].all()


@pytest.mark.parametrize("kind", [modes.ATTITUDE, modes.GYRO])
@pytest.mark.parametrize("repeats_gyro", [False, True])
def test_a_hypothesis_knows_how_axes_are_coupled_in_a_turn(kind, repeats_gyro):
    """U is by how much, per size of the fault, a filter with it differs from one without."""
    size, turning = 1e-5, np.array([0.8, -0.5, 0.3])
    by_attitude, by_gyro = (np.eye(3)[1] * size * (kind == each) for each in (modes.ATTITUDE, modes.GYRO))
    healthy = faulty = motion.start_motion(LEVEL, turning, NOISE)
    bank, q_xyzw = hypotheses.start_bank(np.zeros(3)), LEVEL
    for row in range(40):
        q_xyzw = turn(q_xyzw, turning * DT)
        given = np.zeros(3), np.zeros(3), np.True_, turning, np.full(3, WALK), NOISE, repeats_gyro, DT
        faulty = motion.predict(faulty, *given)
        faulty, _ = motion.take_gyro(faulty, turning + by_gyro, NOISE.gyro, THERE)
        faulty, _ = motion.take_attitude(faulty, turn(q_xyzw, by_attitude), NOISE.attitude, THERE)
        healthy = motion.predict(healthy, *given)
        bank = one_onset(hypotheses.move(bank, healthy.rate, repeats_gyro, DT), row == 0)
        healthy, bank = measure(healthy, bank, turning, q_xyzw)
    moved = [
        rotation_between(faulty.q_xyzw, healthy.q_xyzw),
        *(getattr(healthy, name) - getattr(faulty, name) for name in ("bias", "rate", "unknown")),
    ]
    U = bank.U[:4, :, 3 * kind + 1, SLOT]  # (states, axes)
    assert np.array(moved) / size == pytest.approx(U, rel=0.0, abs=0.002)
    assert abs(U[THETA, 1]) > 0.01


@pytest.mark.parametrize("axis", range(3))
def test_a_hypothesis_knows_which_turns_gravity_shows(axis):
    """One about the vertical is no tilt: a yaw that is off must not be refuted by the accelerometer."""
    q_xyzw, size = quaternion_from_euler(np.array([0.3, -0.2, 1.0])), 1e-6
    state = motion.start_motion(q_xyzw, np.zeros(3), NOISE)
    force = STANDARD_GRAVITY * earth_z_in_body(turn(q_xyzw, size * np.eye(3)[axis]))
    innovation = motion.take_tilt(state, force, np.ones(3), THERE)[1].innovation
    bank = hypotheses.start_bank(np.zeros(3))
    bank.U[THETA, axis, 0] = 1.0
    shown = hypotheses.of_tilt(bank, earth_z_in_body(q_xyzw), modes.pattern(modes.FELT))[:2, 0, 0]
    assert shown == pytest.approx(innovation[:2] / size, abs=1e-5)


def test_an_attitude_of_a_wrong_scale_is_told_by_predicted_turns():
    """The corrected angle follows an attitude that reads nothing; the reckoned one turns on."""
    reckoned, none = np.full(3, 0.1), np.zeros(3)
    for _ in range(25):
        reckoned = motion.reckon(reckoned, none, np.full(3, 0.01), 0.004)
    assert reckoned == pytest.approx(0.1 * np.exp(-0.1) + 0.01 * np.exp(-0.004 * np.arange(1, 26)).sum())
    held = motion.reckon(np.full(3, 3.2), np.full(3, -3.1), none, 1e3)
    assert held == pytest.approx(np.full(3, -3.1))


def test_an_attitude_is_late_by_what_the_vehicle_has_turned_meanwhile():
    time, lead, late = np.arange(2000) * 0.004, np.zeros(3), 0.2
    angle = np.sin(2.0 * time)
    for turned in np.diff(angle):
        lead = modes.ahead(lead, np.full(3, turned), 0.004)
        told = late * modes.late_by(lead)
    assert told == pytest.approx(np.full(3, np.sin(2.0 * (time[-1] - late)) - angle[-1]), abs=0.01)


def test_a_torque_may_have_changed_at_any_time_between_two_samples():
    start = motion.start_motion(LEVEL, np.zeros(3), NOISE)
    given = np.True_, np.zeros(3), np.full(3, WALK), NOISE, False, 0.2
    change = np.array([6.0, 0.0, -6.0])  # rad/s²
    calm, moved = (motion.predict(start, np.zeros(3), each, *given) for each in (np.zeros(3), change))
    more = (moved.covariance - calm.covariance)[:, OMEGA, OMEGA]
    assert more == pytest.approx((change * 0.2) ** 2 / 12.0)  # of what is uniform


def test_a_hypothesis_begins_with_the_rate_and_the_spread_of_the_table():
    bank = hypotheses.start_bank(np.zeros(3))._replace(since=np.array(SPACING))
    believed = believed_of(hypotheses.open_slots(bank, ALIKE, NONE, np.True_, 0.0))
    for row, kind in enumerate(modes.KINDS):
        if row in RETURNS:
            continue
        for axis in range(3):
            mode = 3 * row + axis
            assert (modes.KIND[mode], modes.AXIS[mode]) == (row, axis)
            for ring, spacing in enumerate(SPACING):
                slot = FIRST[ring]
                p = kind.rate / 3600.0 * spacing  # that it began in the time that the slot stands for
                assert believed.log_weight[mode, slot] == pytest.approx(np.log(p))
                assert believed.covariance[:, mode, slot] == pytest.approx([kind.size**2, 0.0, kind.slope**2])
    began = believed.log_weight > hypotheses.LOWEST
    assert began.sum() == (modes.MODES - 6) * len(SPACING)  # there is nothing from which to return


def ages(shown, seconds=6.0, dt=0.004, of=modes.IS_FAULT, driven=np.True_):
    """Ages of the onsets of each ring in the end; modes have ``shown`` something by when they began [s]."""
    bank, now = hypotheses.start_bank(np.zeros(3)), 0.0
    for _ in range(round(seconds / dt)):
        age = bank.age[0]
        worth = hypotheses.USUAL + shown(now - age) * of[:, None]
        worth = np.where(age >= 0.0, worth, hypotheses.LOWEST)
        bank = hypotheses.open_slots(bank, worth, NONE, driven, dt)
        now += dt
    return [np.sort(bank.age[0, FIRST[k] : FIRST[k + 1]]) for k in range(len(SLOTS))]


@pytest.mark.parametrize("shown", [0.0, -5.0])
def test_the_oldest_onset_goes_where_nothing_has_shown(shown):
    full = ages(lambda began: 0.0 * began + shown, seconds=max(np.multiply(SPACING, SLOTS)) + 1.0)
    for row, spacing, slots in zip(full, SPACING, SLOTS, strict=True):
        steps = np.ceil(spacing / 0.004 - 1e-6) * 0.004
        assert np.diff(row) == pytest.approx(np.full(slots - 1, steps), abs=1e-9)
        assert row[0] < steps


def one_second(shown):
    """What has ``shown`` at the onset that began at 1 s."""
    return lambda began: shown * (abs(began - 1.0) < 0.003)


def test_an_onset_stays_while_it_shows_more_than_chance_would_at_as_many():
    lucky = np.log(5.0 / SPACING[0])  # at the luckiest of the onsets of 5 s
    fast, *_ = ages(one_second(lucky + 0.1))
    assert fast[-1] == pytest.approx(5.0, abs=0.006)
    assert fast[:-1] == pytest.approx(np.arange(len(fast) - 1) * 0.004, abs=1e-9)
    fast, *_ = ages(one_second(lucky - 0.1))
    assert fast == pytest.approx(np.arange(len(fast)) * 0.004, abs=1e-9)


def test_without_a_torque_and_for_what_is_no_fault_an_onset_stays_where_it_is_likely():
    shown = np.log(5.0 / SPACING[0]) + 0.1
    unlikely = modes.RATE * SPACING[0] < np.exp(-shown)
    for of, driven in ((modes.IS_FAULT & unlikely, np.False_), (~modes.IS_FAULT & unlikely, np.True_)):
        assert of.any()
        fast, *_ = ages(one_second(shown), of=of, driven=driven)
        assert fast == pytest.approx(np.arange(len(fast)) * 0.004, abs=1e-9)
    for driven in (np.True_, np.False_):
        fast, *_ = ages(one_second(20.0), of=~modes.IS_FAULT, driven=driven)
        assert fast[-1] == pytest.approx(5.0, abs=0.006)


def test_a_wrong_scale_is_held_possible_by_both_witnesses():
    bank = one_onset(hypotheses.start_bank(np.zeros(3)), now=True)
    scaled, step = np.isin(modes.KIND, [*OF_SCALE.values()]), modes.KIND == modes.GYRO
    for good, driven, held in (
        (THERE, np.True_, True),
        (NONE, np.True_, False),
        (THERE, np.False_, False),
    ):
        began = inference.believe(bank, good, THERE, driven, NONE, RARER).log_weight > hypotheses.LOWEST
        assert began[scaled].any(axis=-1).tolist() == [held] * 6
        assert began[step].any(axis=-1).all()


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_a_rate_whose_errors_are_alike_is_known_as_a_white_one_that_averages_alike(rho):
    P, dt, many = np.array([1e-4, 4e-4, 9e-4]), 0.004, 2000
    state = motion.start_motion(LEVEL, np.zeros(3), NOISE)
    cov = np.zeros_like(state.covariance)
    cov[:, motion.OMEGA, motion.OMEGA], cov[:, motion.OMEGA, motion.D] = 0.8 * rho * P, 0.2 * rho * P / dt
    now = state.covariance.copy()
    now[:, motion.OMEGA, motion.OMEGA] = P
    known = motion.rate_vagueness(state._replace(covariance=cov), state._replace(covariance=now), dt)
    apart = abs(np.subtract.outer(np.arange(many), np.arange(many)))
    of_mean = P * (rho**apart).mean()  # of that many errors, each like the one before by rho
    assert known / many == pytest.approx(of_mean, rel=0.02)


def test_a_rate_that_nothing_corrects_is_hardly_known_but_known():
    state = motion.start_motion(LEVEL, np.zeros(3), NOISE)
    known = motion.rate_vagueness(state, state, 0.004)
    assert np.all(known > 50.0 * state.covariance[:, motion.OMEGA, motion.OMEGA])
    assert np.all(np.isfinite(known))


def test_a_gyro_does_not_correct_its_own_scale_but_counts_how_vague_it_is():
    """The covariance is that of a gain which leaves the scale alone (Joseph's form)."""
    rng, rate = np.random.default_rng(3), np.array([0.5, -0.3, 0.8])
    roots = 0.01 * rng.normal(size=(3, motion.STATES, motion.STATES))
    before = motion.start_motion(LEVEL, rate, NOISE)._replace(covariance=roots @ roots.swapaxes(-1, -2))
    after, seen = motion.take_gyro(before, rate + 1e-4, NOISE.gyro, THERE)
    assert np.array_equal(after.scale, before.scale)
    for axis in range(3):
        H = np.zeros(motion.STATES)
        H[[BETA, OMEGA]], H[motion.SCALE] = 1.0, rate
        P, R, kept = before.covariance[axis], NOISE.gyro[axis], np.eye(motion.STATES)
        K = P @ H / (H @ P @ H + R)
        K[motion.SCALE] = 0.0
        np.testing.assert_allclose(seen.gain[axis], K, rtol=1e-9, atol=1e-15)
        expected = (kept - np.outer(K, H)) @ P @ (kept - np.outer(K, H)).T + R * np.outer(K, K)
        np.testing.assert_allclose(after.covariance[axis], expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("age", "learned", "follows"),
    [(4.0, 7.0, True), (4.0, 9.0, False), (19.0, 11.0, True), (19.0, 13.0, False)],
)
def test_old_hypotheses_follow_the_temper_until_the_last_ring_is_full(age, learned, follows):
    """Old: more than half of what was learned is later."""
    bank = one_onset(hypotheses.start_bank(np.zeros(3)), now=True)
    bank = bank._replace(age=np.where(bank.age < 0.0, hypotheses.NEVER, age))
    loud = bank._replace(temper=np.full_like(bank.temper, 3.0), learned=np.full_like(bank.learned, learned))
    after = inference.learn_temper(loud, np.ones((2, 3), bool), 0.0)
    assert (after.doubt[..., SLOT] == (3.0 if follows else hypotheses.DOUBT)).all()


def test_what_a_faulty_gyro_has_taught_of_its_scale_is_forgotten():
    taught = motion.start_motion(LEVEL, np.zeros(3), NOISE)
    taught = taught._replace(scale=np.full((3, 3), 0.2), covariance=0.1 * taught.covariance + 1e-9)
    axes, P = np.array([False, True, False]), taught.covariance
    after = motion.untaught(taught, axes)
    assert np.array_equal(after.scale, np.where(axes[:, None], 0.0, taught.scale))
    assert np.array_equal(after.covariance[[0, 2]], P[[0, 2]])
    own = np.arange(motion.SCALE.start, motion.SCALE.stop)
    assert np.array_equal(after.covariance[1][np.ix_(own, own)], motion.SCALES**2 * np.eye(3))
    others = np.setdiff1d(np.arange(motion.STATES), own)
    assert np.array_equal(after.covariance[1][np.ix_(others, others)], P[1][np.ix_(others, others)])
    assert not after.covariance[1][np.ix_(own, others)].any()
    assert not after.covariance[1][np.ix_(others, own)].any()


def test_a_scale_of_a_rate_that_is_vague_is_told_as_vaguely():
    """A dead gyro misses the rate by as much as that itself is unknown; other faults do not."""
    bank = one_onset(hypotheses.start_bank(np.zeros(3)), now=True)
    seen = motion.Gains(np.ones(3), np.ones(3), np.zeros((3, motion.STATES)), THERE)
    S = np.ones((3, len(modes.COLUMN), sum(SLOTS)))
    sharp, vague = (hypotheses.weigh(bank, OF_GYRO, seen, S, v) for v in (np.zeros(3), np.full(3, 3.0)))
    scaled = (modes.KIND[: modes.EFFECTS] == modes.SCALED)[:, None]
    for before, after, rows in ((sharp.J, vague.J, modes.PRODUCT), (sharp.d, vague.d, modes.COLUMN)):
        np.testing.assert_allclose(after, np.where(scaled[rows], 0.25, 1.0) * before)


def test_onsets_of_an_axis_that_is_believed_again_are_forgotten():
    bank = hypotheses.start_bank(np.zeros(3))._replace(since=np.array(SPACING))
    bank = hypotheses.open_slots(bank, ALIKE, NONE, np.True_, 0.0)
    axes = np.array([False, True, False])
    gone, but_gyros = (hypotheses.forget(bank, axes, settled, NONE).age < 0.0 for settled in (axes, NONE))
    own, of_gyro = modes.AXIS[: modes.EFFECTS] == 1, modes.NAME[: modes.EFFECTS] == modes.GYRO
    assert np.array_equal(gone, own[:, None] | (bank.age < 0.0))
    assert np.array_equal(but_gyros, (own & ~of_gyro)[:, None] | (bank.age < 0.0))


def test_what_a_sensor_reads_while_it_is_stuck_tells_no_size_and_no_scale_without_a_gyro():
    bank = hypotheses.start_bank(np.zeros(3))._replace(since=np.array(SPACING))
    bank = hypotheses.open_slots(bank, ALIKE, NONE, np.True_, 0.0)
    attitude, gyro = np.array([True, False, False]), np.array([False, True, False])
    untold = np.array([False, False, True])
    gone = (hypotheses.disregard(bank, attitude, gyro, untold, NONE).age < 0.0) & (bank.age >= 0.0)
    name, axis, kind = (each[: modes.EFFECTS] for each in (modes.NAME, modes.AXIS, modes.KIND))
    expected = ((name == modes.ATTITUDE) & (axis == 0)) | ((name == modes.GYRO) & (axis == 1))
    expected = expected | ((kind == modes.STRETCHED) & (axis == 2))
    assert np.array_equal(gone.any(axis=-1), expected)


def test_an_attitude_that_neither_gyro_nor_torque_watches_has_no_fault():
    """Coupling would blame it for what another axis shows, even when the gyro is right again."""
    bank = hypotheses.start_bank(np.zeros(3))._replace(since=np.array(SPACING))
    bank = hypotheses.open_slots(bank, ALIKE, NONE, np.True_, 0.0)
    bank = bank._replace(age=np.where(bank.age.max(axis=0) >= 0.0, 0.0, hypotheses.NEVER) + 0.0 * bank.age)
    alone = np.array([False, True, False])
    gone = (hypotheses.disregard(bank, NONE, NONE, NONE, alone).age < 0.0) & (bank.age >= 0.0)
    kinds = modes.ATTITUDE, modes.RETURN, modes.LATE, modes.STRETCHED
    expected = np.isin(modes.KIND, kinds) & alone[modes.AXIS]
    assert np.array_equal(gone.any(axis=-1), expected[: modes.EFFECTS])


@pytest.mark.parametrize("settled", [True, False])
def test_what_the_axis_of_a_named_fault_has_shown_speaks_for_no_other(settled):
    """If that says nothing of the gyro, what this has shown still counts."""
    bank = hypotheses.start_bank(np.zeros(3))
    bank = bank._replace(J=bank.J + 1.0, d=bank.d + 1.0, square=bank.square + 1.0, count=bank.count + 1.0)
    after = hypotheses.forget(bank, np.array([True, False, False]), THERE & settled, NONE)
    left = np.array([[not settled, True, True], [False, True, True]])  # by gyro and attitude
    for part in (after.J, after.d):
        np.testing.assert_array_equal(part, np.broadcast_to(left[..., None, None], part.shape))
    for part in (after.square, after.count):
        np.testing.assert_array_equal(part, np.broadcast_to(left[..., None], part.shape))


def test_a_gyro_whose_attitude_is_not_there_needs_new_evidence_and_nobody_else_does():
    bank = hypotheses.start_bank(np.zeros(3))
    bank = bank._replace(J=bank.J + 1.0, d=bank.d + 1.0)
    after = hypotheses.forget(bank, NONE, NONE, np.array([True, False, False]))
    again = (modes.NAME == modes.GYRO)[: modes.EFFECTS] & (modes.AXIS[: modes.EFFECTS] == 0)
    for part, rows in ((after.J, modes.PRODUCT), (after.d, modes.COLUMN)):
        np.testing.assert_array_equal(part, np.broadcast_to(1.0 * ~again[rows, None], part.shape))


@pytest.mark.parametrize("sensor", range(3))
def test_the_other_axes_of_a_failing_sensor_are_likelier_to_fail(sensor):
    bank = hypotheses.open_slots(hypotheses.start_bank(np.zeros(3)), ALIKE, NONE, np.True_, 1.0)
    well, ill = (believed_of(bank, failing=np.arange(3) == failing) for failing in (3, sensor))
    more = ill.log_weight - well.log_weight
    own = (modes.GYRO, modes.ATTITUDE, modes.FELT)[sensor] == modes.NAME
    began = well.log_weight > hypotheses.LOWEST
    assert np.array_equal(began.any(axis=-1), ~np.isin(modes.KIND, RETURNS))
    assert np.allclose(more[own[:, None] & began], np.log(modes.EVENTS / modes.FAULTS))
    assert not more[~own[:, None] & began].any()


def test_a_gyro_whose_attitude_is_not_good_is_less_likely_to_be_blamed():
    bank = hypotheses.open_slots(hypotheses.start_bank(np.zeros(3)), ALIKE, NONE, np.True_, 1.0)
    alone = believed_of(bank, good_attitude=np.array([False, True, True])).log_weight
    less = alone - believed_of(bank).log_weight
    began = alone > hypotheses.LOWEST
    own = (modes.NAME == modes.GYRO) & (modes.AXIS == 0)
    assert np.allclose(less[own[:, None] & began], RARER)
    assert not less[~own[:, None] & began].any()


def test_without_a_torque_there_is_no_push():
    bank = hypotheses.open_slots(hypotheses.start_bank(np.zeros(3)), ALIKE, NONE, np.True_, 1.0)
    by_hand = inference.believe(bank, THERE, THERE, np.False_, NONE, RARER).log_weight
    told = (by_hand > hypotheses.LOWEST).any(axis=-1)
    needs_torque = (modes.PUSH, modes.SCALED, modes.STRETCHED, modes.WILD)
    assert np.array_equal(told, ~np.isin(modes.KIND, (*RETURNS, *needs_torque)))


@pytest.mark.parametrize("gyro_fails", [True, False])
def test_without_a_torque_an_attitude_that_is_good_tells_a_gyro_and_nothing_else_does(gyro_fails):
    bank = hypotheses.open_slots(hypotheses.start_bank(np.zeros(3)), ALIKE, NONE, np.True_, 1.0)
    held = np.array([True, False, True])
    weight = inference.believe(bank, held, held, np.False_, NONE, RARER, gyro_fails).log_weight
    told = (weight > hypotheses.LOWEST).any(axis=-1)
    steps = modes.KIND == modes.GYRO
    assert told[steps].tolist() == (held & gyro_fails).tolist()
    assert told[modes.KIND == modes.ATTITUDE].all()


def test_no_attitude_is_early():
    bank = hypotheses.open_slots(hypotheses.start_bank(np.zeros(3)), ALIKE, NONE, np.True_, 1.0)
    J, d = (np.zeros_like(part) for part in (bank.J, bank.d))
    J[..., : modes.EFFECTS, :], d[..., : modes.EFFECTS, :] = 50.0, 5.0
    late, early = (believed_of(bank._replace(J=J, d=sign * d)) for sign in (1.0, -1.0))
    worth = late.log_weight - early.log_weight
    began = late.log_weight > hypotheses.LOWEST
    by_delay = (modes.EFFECT // 3 == modes.LATE)[:, None]
    z = late.b[0] ** 2 / late.covariance[0]
    assert np.allclose(worth[by_delay & began], 0.5 * z[by_delay & began])
    assert worth[by_delay & began].min() > 0.0
    assert not worth[~by_delay & began].any()
