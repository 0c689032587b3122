"""Trials of every family: reproducible, valid, different where they say so and nowhere else."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from acquisition import Reading, Recording, SettingError
from training.diagnosis.generators import ensemble
from training.diagnosis.generators.bursts import PAUSE_S
from training.diagnosis.generators.ensemble import FAMILIES, catalogue_of, kinds_of, make_trial
from training.diagnosis.generators.trial import RECORDINGS, load, save
from training.diagnosis.generators.world import Register

PAIRS = [(family, kind) for family in FAMILIES for kind in kinds_of(family)]
ASPECTS = {"bias", "spread", "skew", "detection", "early", "late", "repeat", "memory", "coincidence"}
# columns that a log of the family may hold
COLUMNS = {
    *("time_s", "session", "sensor", "distance_mm", "angle_deg", "incidence_deg", "reflectance", "reading_mm"),
    *("temperature_c", "speed_mps"),
}


def trial_of(family, kind, seed=0, pings=200, **more):
    return make_trial(family, kind, np.random.default_rng([seed, 77]), pings=pings, **more)


def errors_mm(recording):
    """Errors of the echoes near the target, and which rows they are."""
    table = recording.table
    error = (table.reading_mm - table.distance_mm).to_numpy()
    near = (table.reading_mm > 0) & (np.abs(error) < 0.1 * table.distance_mm + 50)
    return error, near.to_numpy()


def pings_of_a_round(recording):
    """Pings of one burst at each distance."""
    table = recording.table
    bursts = 1 + int((np.diff(table.time_s) > PAUSE_S).sum())
    return len(table) // bursts * table.distance_mm.nunique()


@pytest.mark.parametrize(("family", "kind"), PAIRS)
def test_a_trial_has_valid_recordings_of_the_requested_size(family, kind, tmp_path):
    trial = trial_of(family, kind)
    for name in RECORDINGS:
        recording = getattr(trial, name)
        again = Recording.load(recording.save(tmp_path / f"{name}.csv"))
        assert len(again) == len(recording) > 0
        assert set(recording.table.columns) <= COLUMNS
        assert recording.reading.echo.any()
        assert recording.run.min() == 0
    if family != "ruler":  # which may be a hasty set
        if family == "bursts":  # never cut: as many at each distance as come closest to the size that was asked for
            assert abs(len(trial.recorded) - 200) <= 0.5 * pings_of_a_round(trial.recorded)
        if (family, kind) != ("bursts", "several"):
            assert 140 <= len(trial.recorded) <= 260
        assert len(trial.fresh) < 0.6 * len(trial.recorded)
    assert list(trial.simulated.table.columns) == list(trial.recorded.table.columns)
    assert trial.fresh.ping.distance.tolist() == trial.fresh_again.ping.distance.tolist()
    assert trial.fresh.ping.distance.tolist() == trial.fresh_simulated.ping.distance.tolist()
    assert len(trial.causes) in {"single": (1,), "pair": (2,), "odd": (1, 2), "several": (3, 4, 5)}.get(kind, (0,))
    assert bool(trial.fault) == (kind in ("unmodelled", "simulator"))


@pytest.mark.parametrize("family", FAMILIES)
def test_sonars_of_an_odd_trial_share_a_fault_of_the_conditions(family, monkeypatch):
    worlds = []
    monkeypatch.setattr(ensemble, "recordings_of", lambda *given: worlds.extend(given[:2]) or [None] * len(RECORDINGS))
    trial_of(family, "odd")
    simulated, real = worlds
    assert simulated.operators == real.operators
    assert len(real.operators) in (1, 2)


@pytest.mark.parametrize(("family", "kind"), PAIRS)
def test_the_same_seed_gives_the_same_trial(family, kind):
    first, second = trial_of(family, kind, 3, 80), trial_of(family, kind, 3, 80)
    assert (first.seed, first.causes, first.fault) == (second.seed, second.causes, second.fault)
    for name in RECORDINGS:
        assert getattr(first, name).table.equals(getattr(second, name).table)
    assert not trial_of(family, kind, 4, 80).recorded.table.equals(first.recorded.table)


def test_another_process_makes_the_same_trial():
    code = (
        "import numpy as np; from training.diagnosis.generators.ensemble import make_trial;"
        "print(make_trial('bursts', 'pair', np.random.default_rng([0, 77]), pings=200).recorded.table.to_csv())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == trial_of("bursts", "pair").recorded.table.to_csv().strip()


def test_a_trial_survives_its_files(tmp_path):
    trial = trial_of("beam", "single", cause="fixed_clutter")
    again = load(save(trial, tmp_path / "one"))
    assert (again.family, again.kind, again.seed, again.causes) == (trial.family, trial.kind, trial.seed, trial.causes)
    for name in RECORDINGS:
        difference = getattr(again, name).reading.range - getattr(trial, name).reading.range
        assert np.abs(difference).max() < 1e-8


@pytest.mark.parametrize("family", FAMILIES)
def test_every_cause_can_be_planted_and_answers_completely(family):
    for effect in catalogue_of(family):
        trial = trial_of(family, "single", 1, 20, cause=effect, size=1.0)
        (cause,) = trial.causes
        assert cause.effect == effect == cause.accepted[0]
        assert set(cause.aspects) <= ASPECTS
        assert cause.aspects
        assert (cause.parameter is None) or (cause.value is None) or np.isfinite(cause.value)
        assert all(low < high for low, high in cause.region.values())
    assert len(catalogue_of(family)) == len(set(catalogue_of(family))) >= 10


def test_the_rig_and_the_beam_model_know_many_causes():
    assert len(catalogue_of("rig")) >= 15
    assert {"latency"} <= set(catalogue_of("driving"))
    assert {"previous_ping", "stale_repeat"} <= set(catalogue_of("bursts"))


def paired_p(trial):
    """p-value of a paired test of the mean error in conditions that both recordings share; None for too few.

    The driving robot's errors are correlated over the whole log, so that it has no independent conditions.
    """
    first, second = trial.simulated, trial.recorded
    other_air = first.has("temperature_c") and not first.table.temperature_c.equals(second.table.temperature_c)
    if other_air or trial.family == "driving":
        return None
    means = []
    for recording in (first, second):
        error, near = errors_mm(recording)
        rows = [
            recording.table[c]
            for c in ("distance_mm", "angle_deg", "incidence_deg", "reflectance")
            if c in recording.table
        ]
        keys = list(zip(*rows, strict=True))
        if len(set(keys)) == 1:
            keys = list(np.arange(len(recording)) // 20)
        means.append(
            {
                k: np.mean([e for e, n, key in zip(error, near, keys, strict=True) if n and key == k] or [np.nan])
                for k in set(keys)
            }
        )
    shared = [means[1][k] - means[0][k] for k in means[0].keys() & means[1].keys()]
    shared = np.array([d for d in shared if np.isfinite(d)])
    return stats.ttest_1samp(shared, 0.0).pvalue if len(shared) > 5 and shared.std() > 1e-9 else None


def test_two_recordings_of_the_same_sonar_differ_by_chance_only():
    families = [f for f in FAMILIES if f not in ("rig", "driving")]
    p = [paired_p(trial_of(f, "same", seed)) for f in families for seed in range(30)]
    p = np.array([value for value in p if value is not None])
    assert len(p) > 50
    assert stats.kstest(p, "uniform").pvalue > 0.01
    assert np.mean(p < 0.01) <= 0.04


def bias_of(recording):
    error, near = errors_mm(recording)
    return float(np.median(error[near]))


@pytest.mark.parametrize("family", ["rig", "rays", "beam", "driving", "ruler", "bursts"])
def test_an_offset_shifts_the_readings_by_its_true_value(family):
    shifts = []
    for seed in range(3):
        trial = trial_of(family, "single", seed, 400, cause="zero_offset", size=4.0)
        shifts.append(bias_of(trial.fresh) - bias_of(trial.fresh_simulated) - 1000.0 * trial.causes[0].value)
    assert np.median(np.abs(shifts)) < 10.0  # of 48 mm; a register in cm or inches rounds


@pytest.mark.parametrize("family", FAMILIES)
def test_lost_readings_lower_the_share_of_echoes_by_their_true_share(family):
    trial = trial_of(family, "single", 2, 1500, cause="dropped_reading", size=5.0)
    echo = [getattr(trial, name).reading.echo.mean() for name in ("fresh_simulated", "fresh")]
    expected = echo[0] * (1.0 - trial.causes[0].value)
    assert abs(echo[1] - expected) < 0.08


def shares(recording):
    """Shares of echoes, of early, of late and of repeated readings, and the spread of the others in mm."""
    error, near = errors_mm(recording)
    echo = recording.reading.echo
    repeated = (np.diff(recording.reading.range) == 0.0) & echo[1:]
    early, late = echo & ~near & (error < 0), echo & ~near & (error > 0)
    quartiles = np.percentile(error[near], [25, 75])
    return {
        "detection": echo.mean(),
        "early": early.mean(),
        "late": late.mean(),
        "repeat": repeated.mean(),
        "spread": np.ptp(quartiles),
    }


@pytest.mark.parametrize(
    ("effect", "aspect", "sign"),
    [
        ("sensitivity", "detection", -1),
        ("range_gate", "detection", -1),
        ("false_alarm", "early", 1),
        ("fixed_clutter", "early", 1),
        ("background_reflector", "late", 1),
        ("spike", "late", 1),
        ("stale_repeat", "repeat", 1),
        ("quantisation", "repeat", 1),
        ("travel_time_jitter", "spread", 1),
    ],
)
def test_a_cause_shows_in_its_first_aspects(effect, aspect, sign):
    changes = []
    for seed in range(5):
        trial = trial_of("beam", "single", seed, 1500, cause=effect, size=1.5)
        assert aspect in trial.causes[0].aspects
        changes.append(sign * (shares(trial.fresh)[aspect] - shares(trial.fresh_simulated)[aspect]))
    assert np.median(changes) > 0.01


@pytest.mark.parametrize("family", FAMILIES)
def test_no_thermometer_gives_a_change_of_the_air_away(family):
    for effect in {"thermal_drift", "sound_speed"} & set(catalogue_of(family)):
        for seed in range(6):
            trial = trial_of(family, "single", seed, 20, cause=effect)
            value = trial.causes[0].parameter
            assert trial.recorded.has("temperature_c") == (value == "logged_share")


def test_latency_delays_the_readings_of_a_robot():
    trial = trial_of("driving", "single", 5, 1500, cause="latency", size=2.0)
    ping, (error, near) = trial.recorded.ping, errors_mm(trial.recorded)
    speed = np.gradient(ping.distance, ping.time)
    smooth = near & (np.abs(speed) < 1.0) & (np.abs(speed) > 0.02) & (trial.recorded.run == 0)
    lag = -np.median(error[smooth] / 1000.0 / speed[smooth])
    assert trial.causes[0].value == pytest.approx(0.3)
    assert lag == pytest.approx(0.3, abs=0.1)


def test_an_uncompensated_sensor_follows_the_thermometer():
    trial = trial_of("fixed", "single", 0, 800, cause="sound_speed", size=1.0)
    error, near = errors_mm(trial.recorded)
    table = trial.recorded.table
    slope = np.polyfit(table.temperature_c[near], error[near] / table.distance_mm[near], 1)[0]
    assert slope == pytest.approx(-0.5 / 296.0, rel=0.2)


def test_a_burst_alternates_where_the_previous_ping_is_heard():
    """x[k+1] = 2 D - x[k] - w: an early reading is followed by one at the wall."""
    from training.diagnosis.generators.bursts import BurstSonar, _survey

    sonar = BurstSonar(0.005, 1.0, 0.0, 0.0, 1e-9, 0.0, 0.0, 0.0)
    logged, value = sonar.read(_survey(np.array([2.0]), 3, 6, np.random.default_rng(0)), np.random.default_rng(0))
    w = 0.5 * 344.83 * 0.005
    assert value[:6] == pytest.approx([2.0, 2.0 - w, 2.0, 2.0 - w, 2.0, 2.0 - w], abs=1e-6)
    assert np.diff(logged.time[:3]) == pytest.approx([4.0 / 344.83 + 0.005, (4.0 - 2 * w) / 344.83 + 0.005], abs=1e-6)


def test_what_is_not_known_is_refused_with_a_remedy():
    with pytest.raises(SettingError, match="not a family"):
        trial_of("lidar", "same")
    with pytest.raises(SettingError, match="has no trials of kind 'simulator'"):
        trial_of("rig", "simulator")
    with pytest.raises(SettingError, match="has no cause 'latency'"):
        trial_of("rig", "single", cause="latency")
    with pytest.raises(SettingError, match="at least 20"):
        trial_of("rig", "same", pings=3)


@given(st.floats(1e-4, 0.1), st.floats(0.0, 1e9), st.booleans())
def test_a_register_holds_readings_only_whatever_the_link_adds(step_m, value, truncated):
    reading = Register(step_m, truncated)(np.array([value]))
    assert Reading.of(reading).echo[0] == (value > 0.0)
    assert reading[0] == pytest.approx(value, abs=step_m) or value > 1600.0
