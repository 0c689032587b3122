"""What comes from other programs: datagrams, messages, maps, worlds, `.rec` files, and checkpoints and ledgers."""

import contextlib
import json
import lzma
import os
import struct

import numpy as np
import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st

from acquisition import ModelError, SonarError
from acquisition.survey.planfile import load_plan
from noise import IdealModel, load_model
from noise.store import WEIGHTS
from sonar_gym.agent import load_policy
from sonar_gym.bridges.opendlv import decode, encode
from sonar_gym.bridges.opendlv.messages import HEADER, READING
from sonar_gym.bridges.opendlv.rec import recording_of
from sonar_gym.bridges.opendlv.walls import load_map
from sonar_gym.bridges.server import protocol
from sonar_gym.bridges.server.sensors import Sensors
from sonar_gym.bridges.server.server import answer
from sonar_gym.bridges.simulators.webots import load_tables
from tests.fuzz.rule import FUZZ, check_rejected, limited
from training.common.checkpoint import load_checkpoint, save_checkpoint
from training.proof import chain
from training.proof.chain import load as load_ledger

DATAGRAM = encode(READING, {"distance": 1.0}, sent=(1_650_000_000, 5), sampled=(1_650_000_000, 4))
MAP = b"-1,-1,1,-1;\n1,-1,1,1;\n"
WORLD = b'DistanceSensor { name "front" type "sonar" lookupTable [0 0 0.1, 5 5 0.1] }\n'
PING = protocol.framed(protocol.PING, protocol.COUNTS.pack(1, 1) + b"x" + struct.pack("<7d", 1, 0, 0, 0.5, 0, 0, 1))[4:]


@st.composite
def damaged(draw, whole):
    """Bytes cut short, changed, or with others between them."""
    at = draw(st.integers(0, len(whole)))
    return whole[:at] + draw(st.binary(max_size=9)) + whole[at + draw(st.integers(0, 9)) :]


def used_or_rejected(reader, data, tmp_path_factory, name):
    path = tmp_path_factory.mktemp("damaged") / name
    path.write_bytes(data)
    with limited(name), contextlib.suppress(SonarError):
        reader(path)


@FUZZ
@given(data=st.one_of(damaged(DATAGRAM), st.binary().map(lambda b: HEADER + len(b).to_bytes(3, "little") + b)))
def test_datagrams(data):
    assert len(decode(data)) <= 1


@FUZZ
@given(data=st.one_of(damaged(PING), st.binary()))
def test_messages_of_clients(data):
    found = answer(Sensors(IdealModel(), 6.0, 0), data)
    assert found[4:8] in (protocol.READ, protocol.FAIL)


@FUZZ
@given(data=damaged(3 * DATAGRAM), period=st.sampled_from((0.0, 1e-9, 0.1, 1e9)))
def test_rec_files(tmp_path_factory, data, period):
    def read(path):
        recording_of(path, period_s=period, constants={"distance_mm": 1000.0})

    used_or_rejected(read, data, tmp_path_factory, "drive.rec")


@FUZZ
@given(data=damaged(MAP))
@example(data=b"1e308,1,-1e308,1;")
def test_maps(tmp_path_factory, data):
    used_or_rejected(load_map, data, tmp_path_factory, "room.map")


@FUZZ
@given(data=damaged(WORLD))
@example(data=b"{" * 100_000)
@example(data=b"DistanceSensor {" * 10_000)
def test_worlds(tmp_path_factory, data):
    used_or_rejected(load_tables, data, tmp_path_factory, "world.wbt")


class Net(torch.nn.Linear):
    """A policy with one weight and its optimiser."""

    def __init__(self):
        super().__init__(2, 2)
        self.optimizer = torch.optim.Adam(self.parameters())
        self(torch.ones(1, 2)).sum().backward()
        self.optimizer.step()


@FUZZ
@given(data=st.data())
def test_checkpoints(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("run") / "checkpoint"
    save_checkpoint(path, Net(), {"settings": {}})
    used_or_rejected(lambda p: load_checkpoint(p, Net()), data.draw(damaged(path.read_bytes())), tmp_path_factory, "c")


def test_a_checkpoint_of_another_network_is_named(tmp_path):
    other = Net()
    other.extra = torch.nn.Linear(3, 3)
    save_checkpoint(tmp_path / "c", other, {"settings": {}})
    with pytest.raises(ModelError, match=r"c: is not a valid checkpoint .*; start again in another folder"):
        load_checkpoint(tmp_path / "c", Net())


ENDLESS = {
    "plan.toml": load_plan,
    "room.map": load_map,
    "world.wbt": load_tables,
    "ledger.jsonl": load_ledger,
    "drive.rec": lambda path: recording_of(path, constants={"distance_mm": 1.0}),
}


@pytest.mark.parametrize("name", ENDLESS)
def test_devices_and_pipes_are_not_read(tmp_path, name):
    for make in (lambda path: path.symlink_to("/dev/zero"), os.mkfifo, os.mkdir):
        make(tmp_path / name)
        with limited(name), pytest.raises(SonarError, match=name):
            ENDLESS[name](tmp_path / name)
        (tmp_path / name).rmdir() if (tmp_path / name).is_dir() else (tmp_path / name).unlink()


@pytest.mark.parametrize("name", ["weights.safetensors", "README.md", "model.json"])
def test_a_model_folder_with_a_pipe_or_noise_in_place_of_a_file(tmp_path, name):
    for make in (os.mkfifo, lambda path: path.write_bytes(b"\xff\xfe" * 40)):
        folder = tmp_path / make.__name__.strip("<>")
        folder.mkdir()
        for file in ("model.json", "weights.safetensors"):
            (folder / file).write_bytes((WEIGHTS / "srf08-mlp" / file).read_bytes())
        (folder / name).unlink(missing_ok=True)
        make(folder / name)
        with limited(name), contextlib.suppress(ModelError):
            load_model(folder)
            assert name == "README.md"


def test_a_ledger_that_unpacks_to_too_much_or_is_none_is_rejected(tmp_path, monkeypatch):
    monkeypatch.setattr(chain, "MAX_LEDGER", 10_000)
    (tmp_path / "bomb.jsonl.xz").write_bytes(lzma.compress(bytes(10**6)))
    (tmp_path / "empty.jsonl").write_bytes(b"")
    (tmp_path / "other.jsonl").write_text(json.dumps({"a": 1}) + "\n")
    for path in sorted(tmp_path.iterdir()):
        check_rejected("verify-proof", path, names=[path])


def test_an_agent_without_a_training_record_is_not_shipped(tmp_path, valid):
    folder = tmp_path / "agent"
    load_policy("parking").save(folder)
    text = json.loads((folder / "agent.json").read_text())
    for about in ({}, {**text["about"], "history": []}, {**text["about"], "settings": {"sonars": [[1]]}}):
        (folder / "agent.json").write_text(json.dumps({**text, "about": about}))
        check_rejected("ship-agent", folder, "--out", tmp_path / "out", "--episodes", "1", names=["training record"])


def test_bytes_of_the_example_are_a_datagram():
    assert np.isclose(decode(DATAGRAM)[0].fields["distance"], 1.0)
    assert answer(Sensors(IdealModel(), 6.0, 0), PING)[4:8] == protocol.READ
