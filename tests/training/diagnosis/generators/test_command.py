"""The command writes the same labelled pairs for the same seed."""

import pytest

from acquisition import SettingError
from training.diagnosis.generators.command import Args, main, mix
from training.diagnosis.generators.ensemble import KINDS
from training.diagnosis.generators.trial import load


def test_the_command_writes_a_mix_of_trials(tmp_path, capsys):
    for name in ("a", "b"):
        main(Args(tmp_path / name, 4, ("beam", "fixed"), ("same", "single"), 60, 5))
    assert "4 trials" in capsys.readouterr().out
    folders = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert [(load(tmp_path / "a" / f).family, load(tmp_path / "a" / f).kind) for f in folders] == [
        ("beam", "same"),
        ("fixed", "same"),
        ("beam", "single"),
        ("fixed", "single"),
    ]
    for path in (tmp_path / "a").rglob("*.*"):
        assert path.read_bytes() == (tmp_path / "b" / path.relative_to(tmp_path / "a")).read_bytes()


def test_a_mix_holds_the_kinds_that_a_family_has():
    assert ("rays", "simulator") in mix(("rays", "beam"), KINDS)
    assert ("beam", "simulator") not in mix(("rays", "beam"), KINDS)
    with pytest.raises(SettingError, match="no family of beam"):
        mix(("beam",), ("simulator",))
    with pytest.raises(SettingError, match="not a kind"):
        mix(("beam",), ("strange",))
