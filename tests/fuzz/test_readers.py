"""Every reader of files: damaged, foreign and hostile content is used, or rejected by an error of the project."""

import contextlib
import gzip
import json
import shutil
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from stable_baselines3 import PPO

from acquisition import Recording, SonarError
from acquisition.io.logs.bags import GroundTruthSource, import_bag
from acquisition.io.tables import MAX_COLUMNS
from acquisition.survey.planfile import KEYS, find_plan
from noise import load_model, save_model
from noise.composed import ComposedModel
from noise.faults import Faulty, Short
from noise.model import GaussianModel, IdealModel
from noise.physical import PhysicalModel
from noise.store import WEIGHTS
from sonar_gym.agent import WEIGHTS as AGENTS
from sonar_gym.agent import load_policy
from sonar_gym.sb3 import SonarVecEnv
from tests.acquisition.io.logs.test_bags import Bag
from tests.fuzz.rule import EXAMPLES, FUZZ, check_rejected, check_used_or_rejected, digests, limited
from tests.fuzz.tables import csv_bytes
from tests.training.diagnosis.conftest import SITUATIONS
from training.agents.drivers import load_zip
from training.proof.chain import load as load_ledger

VALUES = (None, True, -1, 0, 10**40, 1e308, "x", [], {}, [[]], {"x": 1}, [1e308], "\x00", [None])


@pytest.fixture
def kept(valid):
    """Folder of valid files, which no test may change."""
    before = digests(valid)
    yield valid
    assert digests(valid) == before


def load(reader, *arguments):
    """Return what a reader gives, or None where it raises an error of the project."""
    with limited(arguments), contextlib.suppress(SonarError):
        return reader(*arguments)
    return None


# ---- tables ----------------------------------------------------------------------------------------------------------


def columns_of(*names):
    """Return a table of one ping with further columns."""
    return f"{','.join(('distance_mm', 'angle_deg', 'reading_mm', *names))}\n500,0,501{',1' * len(names)}\n".encode()


@FUZZ
@given(data=csv_bytes())
@example(data=columns_of("distance", "angle", "run", "time", "reflectance"))
@example(data=columns_of(*(f"c{k}" for k in range(10**6))))
@example(data=columns_of("reading_mm"))
@example(data=b"distance_mm;angle_deg;reading_mm\r\n500,5;0;501\r\n")
@example(data=b"distance_mm,angle_deg,reading_mm\r500,0,501\r")
@example(data=gzip.compress(columns_of())[:-9])
@example(data=gzip.compress(b"0" * 2**24))
def test_recordings(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("table") / "recording.csv"
    path.write_bytes(data)
    recording = load(Recording.load, path)
    assert path.read_bytes() == data
    if recording is not None:
        assert len(recording.ping) == len(recording.reading) > 0


@pytest.mark.parametrize("command", ["plot", "train-noise", "diagnose", "import"])
@FUZZ
@given(data=csv_bytes())
def test_commands_on_tables(tmp_path_factory, command, data):
    folder = tmp_path_factory.mktemp("table")
    path = folder / "recording.csv"
    path.write_bytes(data)
    few = {"train-noise": ("--epochs", 1, "--hidden", 2), "import": ("--columns", "distance_mm=distance_mm:cm")}
    check_used_or_rejected(command, path, "--out", folder / "out", *few.get(command, ()))
    assert path.read_bytes() == data


def test_a_table_is_read_whatever_its_line_ends_and_compression(tmp_path):
    data = columns_of("run")
    for k, variant in enumerate((data, data.replace(b"\n", b"\r\n"), b"\xef\xbb\xbf" + data[:-1], gzip.compress(data))):
        path = tmp_path / f"{k}.csv"
        path.write_bytes(variant)
        recording = Recording.load(path)
        assert recording.reading.range.tolist() == [0.501]
        assert recording.ping.covariates["run"].tolist() == [1.0]


def test_the_reason_is_named(tmp_path):
    path = tmp_path / "r.csv"
    reasons = {
        columns_of("reading_mm"): "column 'reading_mm' is given twice",
        columns_of(*"x" * MAX_COLUMNS): f"more than {MAX_COLUMNS} columns",
        b"distance_mm;angle_deg;reading_mm\n1,5;0;1,5\n": "--delimiter ';'",
        b"distance_mm,angle_deg,reading_mm\n500,0,501,7\n": "more fields than the header",
        "distance_mm,angle_deg,reading_mm\n1,0,1\n".encode("utf-16"): "is UTF-16 text",
        b"distance_mm,angle_deg,reading_mm\n1,0,\x00\n": "line 2: contains a null character",
        b"\x1f\x8bno": "damaged gzip file",
        b"": "the file is empty",
    }
    for data, reason in reasons.items():
        path.write_bytes(data)
        check_rejected("plot", path, "--out", tmp_path / "out", names=[reason, path])
    check_rejected("plot", "/dev/zero", "--out", tmp_path / "out", names=["/dev/zero: is a device or a pipe"])


@pytest.mark.parametrize("begin", [b"", b"distance_mm,angle_deg,reading_mm\n", b"Ping: 1 cm\n"])
def test_a_file_without_line_ends_is_rejected_at_once(tmp_path, begin):
    path = tmp_path / "log.csv"
    path.write_bytes(begin + b"1 " * 2 * 10**7)
    check_rejected("import", path, "--out", tmp_path / "out.csv", names=[path])
    check_rejected("plot", path, "--out", tmp_path / "out", names=[path])


TOA5 = b"""\"TOA5\",\"s\",\"CR6\",\"1\",\"o\",\"p\",\"9\",\"t\"
\"TIMESTAMP\",\"R\",\"D\"\n\"TS\",\"m\",\"m\"\n\"\",\"Smp\",\"Smp\"
\"2022-05-21 00:00:00\",1.5,1.5\n\"2022-05-21 00:10:00\",\"NAN\",1.5
"""


@FUZZ
@given(at=st.integers(0, len(TOA5)), cut=st.integers(0, 9), more=st.binary(max_size=5))
@example(at=0, cut=0, more=b"")
def test_logger_files(tmp_path_factory, at, cut, more):
    path = tmp_path_factory.mktemp("logger") / "log.dat"
    path.write_bytes(TOA5[:at] + more + TOA5[at + cut :])
    maps = ("reading_mm=R", "distance_mm=D", "time_s=TIMESTAMP")
    check_used_or_rejected(
        "import", path, "--out", path.with_suffix(".csv"), "--columns", *maps, "--constants", "angle_deg=0"
    )


def test_semicolons_and_decimal_commas_are_read_where_they_are_said(tmp_path):
    (tmp_path / "log.csv").write_text("d;r\n50,5;51\n60,0;61,25\n")
    words = ("import", tmp_path / "log.csv", "--out", tmp_path / "r.csv", "--delimiter", ";", "--decimal", ",")
    maps = ("--columns", "distance_mm=d:cm", "reading_mm=r:cm", "--constants", "angle_deg=0")
    assert check_used_or_rejected(*words, *maps) == 0
    assert Recording.load(tmp_path / "r.csv").reading.range.tolist() == [0.51, 0.6125]


# ---- models and agents -----------------------------------------------------------------------------------------------


def models():
    plain = PhysicalModel.from_dict({"resolution": 0.01, "max_range": 6.0, "effects": {"zero_offset": {}}})
    made = (IdealModel(), GaussianModel(), plain, Faulty(GaussianModel(), [Short(0.1)]))
    return (
        *made,
        ComposedModel(GaussianModel(), plain.effects, plain.effects),
        *map(load_model, ("srf08-mlp", "srf08-hybrid")),
    )


@st.composite
def damaged(draw, content):
    """JSON content with one value replaced, removed or added."""
    place, steps = content, draw(st.integers(0, 3))
    for _ in range(steps):
        keys = list(place) if isinstance(place, dict) else range(len(place))
        inner = [key for key in keys if isinstance(place[key], (dict, list)) and place[key]]
        if inner:
            place = place[draw(st.sampled_from(inner))]
    key = draw(st.sampled_from([*place, "nosuch"] if isinstance(place, dict) else list(range(len(place)))))
    if draw(st.booleans()) and key in place and isinstance(place, dict):
        del place[key]
    else:
        place[key] = draw(st.sampled_from(VALUES))
    return json.dumps(content)


@pytest.mark.parametrize("number", range(len(models())))
@FUZZ
@given(data=st.data())
def test_models(tmp_path_factory, number, data):
    folder = save_model(models()[number], tmp_path_factory.mktemp("model") / "model")
    path = folder / "model.json"
    path.write_text(data.draw(damaged(json.loads(path.read_text()))))
    load(load_model, folder)


@FUZZ
@given(data=st.data())
def test_agents(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("agent") / "agent"
    shutil.copytree(AGENTS / "parking", folder)
    path = folder / "agent.json"
    path.write_text(data.draw(damaged(json.loads(path.read_text()))))
    load(load_policy, folder)


@pytest.fixture(scope="module")
def learner(tmp_path_factory):
    """File of a model of Stable-Baselines3."""
    path = tmp_path_factory.mktemp("learner") / "model.zip"
    PPO("MultiInputPolicy", SonarVecEnv(1, threads=1), n_steps=16, batch_size=16, device="cpu").save(path)
    return path


@FUZZ
@given(data=st.data())
def test_models_of_stable_baselines(learner, tmp_path_factory, data):
    path = tmp_path_factory.mktemp("learner") / "model.zip"
    settings = data.draw(damaged({"policy_kwargs": {"net_arch": [8], "optimizer_kwargs": {"eps": 1e-5}}}))
    with zipfile.ZipFile(learner) as whole, zipfile.ZipFile(path, "w") as changed:
        weights, cut = whole.read("policy.pth"), data.draw(st.sampled_from((None, None, 0, 100, -9)))
        changed.writestr("data", settings)
        changed.writestr("policy.pth", weights[:cut])
    load(load_zip, path, data.draw(st.sampled_from(("ppo", "sac", "ppo_lstm"))))


@pytest.fixture(scope="module")
def verdict(tmp_path_factory):
    """Content of a verdict.json."""
    return SITUATIONS["scale"]().verdict.to_dict()


@FUZZ
@given(data=st.data())
def test_verdicts(verdict, tmp_path_factory, data):
    path = tmp_path_factory.mktemp("run") / "verdict.json"
    path.write_text(data.draw(damaged(json.loads(json.dumps(verdict)))))
    assert check_used_or_rejected("view", path.parent) == 0


@pytest.mark.parametrize("text", ["NaN", '{"a": NaN}', "[" * 100_000, '{"format": 1, "kind": "ideal"', '"', "\ud800"])
def test_text_that_is_no_model(tmp_path, text):
    (tmp_path / "model.json").write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(SonarError, match=r"model\.json"):
        load_model(tmp_path)


@FUZZ
@given(
    size=st.integers(0, 2**64 - 1),
    header=st.sampled_from(("{}", "x", '{"0.weight": {"dtype": "F32"}}')),
    data=st.data(),
)
@example(size=10 * 2**30, header="{}", data=None)
def test_weights(tmp_path_factory, size, header, data):
    folder = tmp_path_factory.mktemp("model") / "model"
    shutil.copytree(WEIGHTS / "srf08-mlp", folder)
    weights = folder / "weights.safetensors"
    whole = weights.read_bytes()
    cut = 0 if data is None else data.draw(st.integers(0, len(whole)))
    weights.write_bytes(struct.pack("<Q", size) + header.encode() + whole[cut:])
    with limited(folder), pytest.raises(SonarError, match=r"weights\.safetensors"):
        load_model(folder)


# ---- plans and ledgers -----------------------------------------------------------------------------------------------

NAMES = (*KEYS, "nosuch", "sweep.gain", '"\\u001b"')
TOML = st.sampled_from(
    ("[]", "[0]", "[nan]", "[inf]", "[1e308, -1]", "-1", "true", "nan", '"x"', "{from = 0, to = 1e9, step = 1e-9}",
     "{from = 1, to = 0, step = 0}", "[[1]]", "1979-05-27", "{a = [1]}", "9" * 23, "[1" + ", 1" * 9 + "]")
)  # fmt: skip


@FUZZ
@given(
    fields=st.dictionaries(st.sampled_from((*KEYS, "nosuch", "sweep.gain", '"\\u001b"')), TOML),
    tail=st.text(max_size=9),
)
def test_plans(tmp_path_factory, fields, tail):
    path = tmp_path_factory.mktemp("plan") / "plan.toml"
    given_fields = {"angles_deg": "[0]", "distances_mm": "[500]", **fields}
    text = "".join(f"{name} = {value}\n" for name, value in given_fields.items()) + tail
    path.write_text(text, encoding="utf-8", errors="surrogatepass")
    load(find_plan, str(path))


@FUZZ
@given(data=st.one_of(st.binary(), st.text().map(lambda text: json.dumps({"event": text}).encode() + b"\n")))
def test_ledgers(tmp_path_factory, data):
    for name in ("ledger.jsonl", "ledger.jsonl.xz"):
        path = tmp_path_factory.mktemp("ledger") / name
        path.write_bytes(data)
        load(load_ledger, path)


# ---- bags ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["ros1", "mcap", "sqlite"])
def bag(request, tmp_path_factory):
    """Path of the file of a small bag."""
    folder = tmp_path_factory.mktemp("bag")
    with Bag(folder, request.param) as bag:
        for k in range(20):
            bag.range("/sonar", 1.0 + k, 1.5)
    return next(path for path in sorted(Path(folder).rglob("*")) if path.suffix in (".bag", ".mcap", ".db3"))


def test_bags_cut_short(bag, tmp_path):
    whole = bag.read_bytes()
    ends = [
        *range(0, 500, 1 if EXAMPLES else 25),
        *np.random.default_rng(0).integers(500, len(whole), 200 if EXAMPLES else 8),
    ]
    path = tmp_path / bag.name
    for end in ends:
        path.write_bytes(whole[:end])
        load(import_bag, path, (), GroundTruthSource(), {"distance_mm": 1500.0})


@FUZZ
@given(place=st.floats(0, 1, exclude_max=True), bits=st.integers(1, 255))
def test_bags_with_a_wrong_byte(bag, tmp_path_factory, place, bits):
    data = bytearray(bag.read_bytes())
    data[int(place * len(data))] ^= bits
    path = tmp_path_factory.mktemp("damaged") / bag.name
    path.write_bytes(data)
    load(import_bag, path, (), GroundTruthSource(), {"distance_mm": 1500.0})


@pytest.mark.parametrize("field", ["radiation_type", "frame_id", "min_range", "stamp", "float32 range"])
def test_a_bag_defines_its_own_messages(bag, tmp_path, field):
    old, path = field.encode(), tmp_path / bag.name
    for new in (old[:-1] + b"X", b"float64 " + old[8:]):
        path.write_bytes(bag.read_bytes().replace(old, new))
        load(import_bag, path, (), GroundTruthSource(), {"distance_mm": 1500.0})


def test_valid_files_are_used(kept):
    assert load(find_plan, str(kept / "plan.toml")) is not None
    assert load(load_model, kept / "model") is not None
    assert load(Recording.load, kept / "recording.csv") is not None
