"""Records of stub diagnoses: what the table and the fit of the decision model read."""

import pytest

EVIDENCE = {
    "gain": 100.0,
    "gain_error": 10.0,
    "n_pings": 1000,
    "n_visits": 80,
    "lead_unnamed": 30.0,
    "lead_unnamed_error": 10.0,
    "share": 0.9,
    "rest": 0.05,
    "lead": 10.0,
    "prior": -0.5,
    "p_before": 0.0005,
    "p_after": 0.3,
    "p_stable": 0.4,
    "variation": 0.0,
    "n_effects": 1,
    "catch_all": False,
}
OFFSET = {"effect": "zero_offset", "accepted": ["zero_offset"], "size": 1.0, "parameter": "offset_m", "value": 0.01}
OFFSET |= {"aspects": ["bias"], "region": {}}
SCALE = OFFSET | {"effect": "clock_scale", "accepted": ["clock_scale", "sound_speed"], "parameter": None, "value": None}


def cause(effect="zero_offset", probability=0.9, share=0.95, **alternatives):
    """Return a cause as verdict.json holds it."""
    others = [{"effect": name, "probability": p} for name, p in alternatives.items()]
    return {"effect": effect, "probability": probability, "share": share, "alternatives": others}


@pytest.fixture
def record():
    """Return a function that makes a record; by default a 10 mm offset that is named and corrected."""

    def make(family="beam", kind="single", number=0, causes=(OFFSET,), named=None, p_value=0.0005, **changed):
        named = [cause()] if named is None else named
        held_out = {"before": {"crps_mm": 12.0}, "after": {"crps_mm": 3.0}, "repeatability_mm": 2.0}
        verdict = {"verdict": "explained" if named else "none", "p_value": p_value, "causes": named}
        verdict |= {"where": [{"aspect": "bias"}] if named else [], "held_out": held_out}
        scores = {"before": 0.012, "again": 0.002, "corrected": 0.003, "causes_only": 0.004, "own": 0.003}
        return {
            "family": family,
            "kind": kind,
            "number": number,
            "seed": 0,
            "pings": 1000,
            "id": f"{family}/{kind}/{number}",
            "commit": "0",
            "n": 1000,
            "error": None,
            "seconds": 2.0,
            "causes": list(causes),
            "fault": "",
            "verdict": verdict,
            "intervals": {"zero_offset": {"offset_m": [0.0101, 0.009, 0.011]}} if named else {},
            "overlap": [1.0] if named else [],
            "evidence": {each["effect"]: EVIDENCE for each in named},
            "likely": {each["effect"]: {each["effect"]: 1.0} for each in named},
            "scores": scores | {"gap_error": 0.001, "corrected_error": 0.001, "own_error": 0.001, "offered": True},
        } | changed

    return make
