"""The page of a folder of results."""

import json
import os
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import noise
import sonar_gym
from acquisition import Ping, Reading, Recording
from training.cli import main


@pytest.fixture
def results(tmp_path):
    distance = np.linspace(0.3, 3.0, 50)
    recording = Recording.of(Ping.of(distance=distance, reflectance=0.9), Reading.of(distance))
    recording.save(tmp_path / "rec & <b>.csv")
    (tmp_path / "notes.csv").write_text("a,b\n1,2\n")
    noise.save_model(noise.load_model("gaussian"), tmp_path / "mysonar")
    shutil.copytree(Path(sonar_gym.__file__).parent / "weights" / "parking", tmp_path / "run" / "agent")
    (tmp_path / "diagnosis").mkdir()
    (tmp_path / "diagnosis" / "verdict.json").write_text('{"verdict": "none", "summary": "No difference."}')
    return tmp_path


def test_each_kind_of_result_is_listed_with_its_picture(results, capsys):
    main(["view", str(results)])
    path = Path(capsys.readouterr().out.strip())
    text = path.read_text()
    assert [f'id="{kind}"' in text for kind in ("Diagnoses", "Recordings", "Models", "Agents")] == [True] * 4
    assert "none: No difference." in text
    assert "rec &amp; &lt;b&gt;.csv" in text
    assert "notes.csv" not in text
    assert text.count("data:image/png;base64,") == 2  # of the recording and of the model
    for target in re.findall(r'href="([^"#]+)"', text):
        assert (
            path.parent / target.replace("%20", " ").replace("%26", "&").replace("%3C", "<").replace("%3E", ">")
        ).exists()


def test_a_result_that_cannot_be_read_says_why(results, capsys):
    (results / "mysonar" / "model.json").write_text('{"kind": "gaussian"')
    main(["view", str(results), "--out", str(results / "page.html")])
    assert "cannot be read" in (results / "page.html").read_text()


@pytest.mark.skipif(sys.platform == "darwin", reason="names of files are UTF-8 there")
@pytest.mark.parametrize("name", ["verdict.json", "model.json"])
@pytest.mark.parametrize("content", ["[]", "3", '{"verdict": 3, "summary": 1, "kind": []}', "[" * 100_000])
def test_a_file_of_another_kind_says_so(tmp_path, capsys, name, content):
    (tmp_path / name).write_text(content)
    main(["view", str(tmp_path)])
    assert "damaged or of another version" in Path(capsys.readouterr().out.strip()).read_text()


def test_names_that_are_not_utf_8_are_spelled_and_linked(results):
    shutil.copy(results / "rec & <b>.csv", results / os.fsdecode(b"\xff.csv"))
    (results / os.fsdecode(b"\xff.png")).write_bytes(b"")
    main(["view", str(results)])
    page = (results / "index.html").read_text()
    assert r">\udcff.csv<" in page
    assert "rename the file" in page
    assert 'src="%FF.png"' in page


def test_a_page_of_the_user_is_not_replaced(tmp_path, capsys):
    page = tmp_path / "index.html"
    page.write_text("<p>mine</p>")
    with pytest.raises(SystemExit):
        main(["view", str(tmp_path)])
    assert "index.html: exists already and is no page of `sonar-gym view`; give another file with --out" in (
        capsys.readouterr().err
    )
    assert page.read_text() == "<p>mine</p>"
    page.unlink()
    for _ in range(2):
        main(["view", str(tmp_path)])
    assert "No recording" in page.read_text()


def test_an_empty_folder_says_so(tmp_path):
    main(["view", str(tmp_path)])
    assert "No recording, model, diagnosis or agent" in (tmp_path / "index.html").read_text()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes: Linux or macOS")
def test_a_pipe_and_a_link_to_nothing_are_no_results(results, capsys):
    os.mkfifo(results / "pipe.csv")
    (results / "link.csv").symlink_to(results / "nothing")
    main(["view", str(results)])
    text = Path(capsys.readouterr().out.strip()).read_text()
    assert "pipe.csv" not in text
    assert "link.csv" not in text


def test_an_agent_of_the_zoo_is_listed_with_its_curve(tmp_path, capsys):
    from torch.utils.tensorboard import SummaryWriter

    folder = tmp_path / "ppo"
    with SummaryWriter(str(folder / "tensorboard" / "ppo_0")) as board:
        for k in range(3):
            board.add_scalar("rollout/success_rate", 0.4 * k, 1000 * k)
    (folder / "model.zip").write_bytes(b"")
    result = {"algorithm": "ppo", "env": "SonarParking-v0", "sonar": "ideal", "episodes": 200, "share": 0.985}
    (folder / "result.json").write_text(json.dumps(result))
    (tmp_path / "result.json").write_text("{}")  # of another program
    main(["view", str(tmp_path)])
    text = Path(capsys.readouterr().out.strip()).read_text()
    assert "ppo of the zoo, SonarParking-v0 with sonar ideal: parked in 98.5% of 200 unseen streets" in text
    assert text.count("data:image/png;base64,") == 1
    assert "cannot be read" not in text
