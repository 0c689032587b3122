"""The console command, also as a process: output and exit code."""

import os
import shutil
import sqlite3
import subprocess
import sys

import pytest

import acquisition
from training.cli import COMMANDS, GROUPS, SHELLS, main
from training.common.door import MAX_LINE, one_line, reason_of


def sonar_gym(*args):
    return subprocess.run([sys.executable, "-m", "training.cli", *map(str, args)], capture_output=True, text=True)


def test_help_names_every_command(capsys):
    main(["--help"])
    text = capsys.readouterr().out
    assert all(f"  {name} " in text for name in COMMANDS)


def test_the_help_is_grouped(capsys):
    main([])
    text = capsys.readouterr().out
    places = [text.index(f"{group}:\n") for group in GROUPS]
    assert places == sorted(places)


def test_the_version_is_that_of_the_packages(capsys):
    main(["--version"])
    assert capsys.readouterr().out == f"sonar-gym {acquisition.__version__}\n"


@pytest.mark.slow
@pytest.mark.parametrize("shell", SHELLS)
def test_a_shell_completes_commands_and_options(shell, capsys):
    main(["completion", shell])
    text = capsys.readouterr().out
    assert all(name in text for name in COMMANDS)
    assert "--range-register" in text
    (line,) = [line for line in text.splitlines() if line.startswith("COMPLETION_SPEC = ")]
    assert r"\n" not in line
    assert [name for name, (_, summary) in COMMANDS.items() if summary.replace("'", r"\'") not in line] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shell", "asks"),
    [
        ("bash", "source {}; complete -p sonar-gym"),
        ("zsh", "autoload -U compinit; compinit -D; source {}; print $_comps[sonar-gym]"),
        ("fish", "source {}; complete -C 'sonar-gym diagn'"),
    ],
)
def test_a_shell_sources_its_script(shell, asks, capsys, tmp_path):
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell}: install it to test its completion")
    main(["completion", shell])
    script = tmp_path / "script"
    script.write_text(capsys.readouterr().out)
    done = subprocess.run([shell, "-c", asks.format(script)], capture_output=True, text=True)
    assert done.stderr == ""
    assert {"bash": "-F _tyro_sonar_gym", "zsh": "_tyro_sonar_gym"}.get(shell, "diagnose\tfind where") in done.stdout


def test_an_unknown_shell_is_named(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["completion", "dos"])
    assert stop.value.code == 2
    assert "expected one shell of bash, zsh, fish, got 'dos'" in capsys.readouterr().err


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_its_options(name, capsys):
    with pytest.raises(SystemExit) as stop:
        main([name, "--help"])
    assert stop.value.code == 0
    assert "options" in capsys.readouterr().out


def test_an_unknown_command_is_one_line_and_exit_code_2():
    done = sonar_gym("diagnos")
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert "'diagnos' is not a command; did you mean diagnose?" in done.stderr


def test_a_name_like_no_other_lists_the_commands(capsys):
    with pytest.raises(SystemExit):
        main(["qqq"])
    assert "'qqq' is not a command; commands: demo, record" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("prove --out x --trials 1.5", "prove: --trials: expected a whole number, got '1.5'."),
        ("record --out x --temperature-c warm", "record: --temperature-c: expected a number, got 'warm'."),
        ("record --out x --pings x", "record: --pings: expected a whole number, got 'x'."),
        ("import a --out b --truth-point 1 x 3", "--truth-point: expected three numbers, got '1', 'x', '3'."),
        ("sweep --seeds 1 x", "sweep: --seeds: not all of its values are of its type: '1', 'x'."),
        ("zoo ppo --out x --ste 3", "zoo: Unrecognized options: --ste, 3; did you mean --steps? See"),
        ("plot x", "--out PATH Output folder of the figures, PNG. (required)."),
    ],
)
def test_what_the_parser_rejects_is_said_in_plain_words(words, reason, capsys):
    with pytest.raises(SystemExit) as stop:
        main(words.split())
    assert stop.value.code == 2
    assert reason in capsys.readouterr().err


def test_a_value_with_a_foreign_line_end_does_not_cut_the_message(capsys):
    with pytest.raises(SystemExit):
        main(["record", "--out", "r.csv", "--driver", "no\x85x"])
    assert "--driver" in capsys.readouterr().err


def test_a_fault_of_the_program_is_one_line_and_a_crash_file(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("training.pages.effects.main", lambda args: [][0])
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(SystemExit) as stop:
        main(["effects"])
    assert stop.value.code == 1
    line = capsys.readouterr().err
    assert line.startswith("sonar-gym: unexpected IndexError: list index out of range; details: ")
    (crash,) = tmp_path.iterdir()
    assert str(crash) in line
    text = crash.read_text()
    assert "sonar-gym effects" in text
    assert "IndexError" in text
    assert "packages: sonar-gym" in text


@pytest.mark.parametrize(
    ("said", "line"),
    [((), "all files written so far are complete"), (("r.csv: 1 of 2 conditions",), "r.csv: 1 of 2 conditions")],
)
def test_ctrl_c_is_one_line_and_exit_code_130(monkeypatch, capsys, said, line):
    monkeypatch.setattr("training.cli.overview", lambda: (_ for _ in ()).throw(KeyboardInterrupt(*said)))
    with pytest.raises(SystemExit) as left:
        main([])
    assert left.value.code == 130
    assert capsys.readouterr().err == f"sonar-gym: interrupted; {line}\n"


def test_debug_shows_the_traceback(monkeypatch):
    monkeypatch.setattr("training.pages.effects.main", lambda args: [][0])
    with pytest.raises(IndexError):
        main(["effects", "--debug"])


def test_a_missing_file_is_one_line_and_exit_code_2(tmp_path):
    done = sonar_gym("import", tmp_path / "no.csv", "--out", tmp_path / "r.csv", "--columns", "distance_mm=d:m")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "no.csv: no such file" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_full_disk_below_a_database_is_foreseen():
    database = sqlite3.connect(":memory:")
    database.execute("PRAGMA max_page_count = 1")
    with pytest.raises(sqlite3.OperationalError) as failed:
        database.execute("CREATE TABLE t (x)")
    database.close()
    assert "free disk space" in reason_of(failed.value)


def test_a_result_that_another_process_wrote_is_named(tmp_path):
    (tmp_path / "fresh").mkdir()
    (tmp_path / "result" / "data").mkdir(parents=True)
    with pytest.raises(OSError, match="not empty") as failed:
        (tmp_path / "fresh").rename(tmp_path / "result")
    assert reason_of(failed.value).startswith(f"{tmp_path / 'result'}: Directory not empty: another process")


def test_a_name_that_the_terminal_cannot_show_is_spelled_out(tmp_path):
    out = tmp_path / "ü.csv"
    words = [sys.executable, "-m", "training.cli", "record", "--pings", "1", "--out", str(out)]
    done = subprocess.run(words, capture_output=True, text=True, env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert done.returncode == 0, done.stderr
    assert r"\xfc.csv" in done.stdout
    assert out.is_file()


def test_a_real_log_is_imported(real_recordings, tmp_path, capsys):
    out = tmp_path / "calibration.csv"
    columns = ["distance_mm=true_cm:cm", "reading_mm=measured_cm:cm", "session=source_file", "temperature_c=temp1_c"]
    source = real_recordings / "hcsr04-calibration" / "readings.csv"
    main(["import", str(source), "--out", str(out), "--columns", *columns, "--constants", "angle_deg=0"])
    assert "3150 pings in 45 conditions and 20 runs" in capsys.readouterr().out
    assert out.is_file()


def test_recording_needs_no_learning_library():
    heavy = "{'torch', 'gymnasium', 'scipy'}"
    code = f"import sys, training.cli, training.recordings.record; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def test_a_long_message_is_cut_between_its_start_and_its_end_and_keeps_its_paths():
    path = "/data/" + "folder/" * 5 + "file.csv"
    line = one_line(f"start {'x ' * 300} {path} {'y ' * 300} end\x1b[2J\u202e")
    assert len(line) <= MAX_LINE
    assert line.isprintable()
    assert line.startswith("start x")
    assert path in line
    assert line.endswith(r"end\x1b[2J\u202e")
