import json

import pytest

from training.diagnosis.judging import rows
from training.proof.chain import linked, parse
from training.proof.run import LEDGER, Args, Runner, close, opened

N_TRIALS = 8


def interval(value):
    return {"value": value, "low": 0.9 * value, "high": 1.1 * value, "level": 0.9, "unit": "m"}


def stub_verdict(effect):
    cause = {"effect": effect, "probability": 0.9, "alternatives": [], "share": 0.95, "parameters": {}}
    held = {"before": {"crps_mm": 9.0}, "after": {"crps_mm": 5.0}, "repeatability_mm": 4.0}
    content = {"verdict": "explained", "p_value": 0.0005, "where": [], "causes": [cause], "held_out": held}
    return {"verdict": content, "error": None, "seconds": 1.0}


def stub_diagnose(files, without=()):
    """Name an effect after the number of bytes, so that trials have different verdicts."""
    assert set(files) <= {"simulated.csv", "recorded.csv"}
    return stub_verdict(("zero_offset", "spike", "sound_speed")[len(files["recorded.csv"]) % 3]), b"model"


def stub_score(answer, model):
    assert model == b"model"
    scores = dict.fromkeys(("before", "again", "corrected", "causes_only", "own", "process", "beam"), 0.01)
    return {
        "intervals": {},
        "overlap": [],
        "evidence": {},
        "likely": {},
        "scores": {
            **scores,
            "before": 0.03,
            "gap_error": 0.001,
            "corrected_error": 0.001,
            "own_error": 0.001,
            "offered": True,
        },
        "baselines": {"classifier_p": 0.5, "mmd_p": 0.5, "independent": ""},
    }


def call(function, *arguments):
    return function(*arguments)


def args_of(out, trials=N_TRIALS):
    return Args(out, trials=trials, pings=40, left_out=1, workers=2)


def run_stub(args, diagnose=stub_diagnose):
    """Run a deck with a stub in the place of the diagnosis; return the ledger's lines."""
    chain = opened(args)
    try:
        Runner(chain, args.out, args.workers, call, diagnose, stub_score).run()
        close(chain, args.announce)
        return list(chain.lines)
    finally:
        chain.close()


def forged(lines):
    """Return lines with hashes computed anew, as a forger would."""
    out, before = [], "0" * 64
    for line in lines:
        content = {k: v for k, v in line.items() if k not in ("event", "before", "hash")}
        out.append(json.loads(json.dumps(linked(line["event"], content, before))))
        before = out[-1]["hash"]
    return out


@pytest.fixture(scope="session", autouse=True)
def few_draws():
    """Compute intervals of the table from few bootstrap draws; nothing here depends on them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rows, "N_BOOTSTRAP", 10)
        yield


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """A finished ledger: its folder, bytes and lines."""
    out = tmp_path_factory.mktemp("proof")
    run_stub(args_of(out))
    data = (out / LEDGER).read_bytes()
    return out, data, parse(data, "ledger")
