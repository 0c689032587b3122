"""`sonar-gym record` from end to end."""

from pathlib import Path

import numpy as np
import pytest

from acquisition import Recording
from training.cli import main

FEW = ["--pings", "2", "--interval-s", "1"]


@pytest.mark.parametrize("driver", ["rig", "twin"])
def test_records_the_quick_plan(tmp_path, capsys, driver):
    path = tmp_path / "r.csv"
    main(["record", "--driver", driver, "--out", str(path), "--unit", "5", "--gain", "20", *FEW])
    assert "240 pings on 120 conditions" in capsys.readouterr().out
    recording = Recording.load(path)
    assert recording.ping.covariates["gain"] == pytest.approx(np.full(240, 20.0))
    near = (recording.ping.angle == 0) & (recording.ping.distance < 1.0) & recording.reading.echo
    assert near.sum() > 10
    assert np.abs(recording.reading.range - recording.ping.distance)[near].max() < 0.08


def test_same_seed_same_file_and_resuming_a_whole_one_changes_nothing(tmp_path, capsys):
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for path in paths:
        main(["record", "--out", str(path), "--seed", "1", *FEW])
    first = paths[0].read_bytes()
    assert first == paths[1].read_bytes()
    capsys.readouterr()
    with pytest.raises(SystemExit):
        main(["record", "--out", str(paths[0]), "--seed", "1", *FEW])
    error = capsys.readouterr().err.strip()
    assert error.endswith("a.csv: is there already; go on with it (--resume) or give another file")
    main(["record", "--out", str(paths[0]), "--seed", "1", "--resume", *FEW])
    assert paths[0].read_bytes() == first


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--gain", "49"], "gain must be a whole number from 0 to 31, got 49"),
        (["--driver", "srf08", "--bus", "987"], "/dev/i2c-987"),
        (["--driver", "srf08", "--bus", "987", "--address", "224"], "/dev/i2c-987"),
        (["--driver", "twin", "--resume"], "--resume does not go with --driver twin"),
    ],
)
def test_what_cannot_be_is_told_in_a_line(tmp_path, capsys, options, message):
    with pytest.raises(SystemExit) as stop:
        main(["record", "--out", str(tmp_path / "r.csv"), *options])
    assert stop.value.code == 2
    error = capsys.readouterr().err.strip()
    assert message in error
    assert "\n" not in error
    assert not Path(tmp_path / "r.csv").exists()
