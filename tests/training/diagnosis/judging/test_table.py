"""Figures of records whose answers are known by construction."""

import json
from dataclasses import replace

import numpy as np
import pytest

from noise.discrepancy.moments.bootstrap import DRAWS, Greatest, any_of, joint
from noise.discrepancy.result import PValue
from noise.effects import CATALOGUE
from training.diagnosis.generators.grammar import AT_ONE
from training.diagnosis.judging import scoring
from training.diagnosis.judging.page import as_json, is_right, judged, markdown
from training.diagnosis.judging.rows import rows, share

from .conftest import OFFSET, SCALE, cause


def found(records):
    return {row.metric: row for row in rows(records)}


def test_a_share_has_the_wilson_interval():
    """Brown, Cai and DasGupta (2001): 9 of 10 has the Wilson interval 0.596 to 0.982."""
    row = share("x", (0.8, np.inf), [True] * 9 + [False])
    assert (row.low, row.high) == pytest.approx((0.596, 0.982), abs=1e-3)
    assert row.hit
    assert replace(row, target=(0.95, np.inf)).hit is False


def test_a_right_answer_meets_every_target_that_it_is_part_of(record):
    figures = found([record(number=k) for k in range(10)])
    named = (
        "strong single: true cause most probable",
        "strong single: no wrong cause > 10 %",
        "strong single: aspect right",
    )
    assert all(figures[name].value == 1.0 and figures[name].n == 10 for name in named)
    assert figures["single, 15 nats apart in CRPS: true cause most probable"].n == 10
    assert figures["strong single, acts everywhere: IoU"].value == 1.0
    assert figures["90 % intervals cover"].value == 1.0
    assert figures["fresh recording, corrected model, known causes: median gap closed"].value == pytest.approx(0.9)
    assert figures["unseen visits, strong: median gap closed"].value == pytest.approx(0.9)
    assert figures["stated probabilities: calibration error"].value == pytest.approx(0.1)


def test_errors_count_in_their_own_row_alone(record):
    broken = {
        key: record()[key] for key in ("family", "kind", "number", "seed", "pings", "id", "commit", "n", "causes")
    }
    figures = found([record(), broken | {"fault": "", "error": "ValueError: x"}])
    assert figures["diagnosis ended in an error"].value == 0.5
    assert figures["strong single: true cause most probable"].n == 1


def test_nulls(record):
    p = np.linspace(0.001, 0.999, 200)
    null = [record(kind="same", causes=(), named=[], number=k, p_value=each) for k, each in enumerate(p)]
    figures = found([*null, record(kind="same", causes=(), number=200)])
    assert figures["same sonar twice: verdict other than none"].value == pytest.approx(1 / 201)
    assert figures["same sonar twice: a cause named"].hit
    assert figures["same sonar twice: p < 5 %"].hit
    assert figures["same sonar twice: p-values uniform (KS p)"].value > 0.9


def test_the_most_probable_effect_counts_whether_cause_or_alternative(record):
    assert not scoring.leads(record(named=[cause(probability=0.4, spike=0.5)]))
    assert scoring.leads(record(causes=(SCALE,), named=[cause("spike", 0.4, sound_speed=0.5)]))
    assert not scoring.leads(record(named=[]))


def test_the_clearest_difference_that_the_tests_can_show_is_strong(record):
    draws = np.random.default_rng(0).permuted(np.tile(np.arange(DRAWS, dtype=float), (2, 1)), axis=1)
    clearest = [Greatest(PValue(1.0 / (DRAWS + 1), DRAWS, 100, 6), each) for each in draws]
    assert scoring.is_strong(record(causes=(OFFSET,), p_value=joint(*clearest).value))


def test_the_least_p_value_of_five_tests_is_strong(record):
    """A recording of one position has tests of which none is joint with another."""
    clearest = PValue(1.0 / (DRAWS + 1), DRAWS, 100, 6)
    assert scoring.is_strong(record(p_value=any_of(*[clearest] * 5).value))
    assert not scoring.is_strong(record(p_value=any_of(*[replace(clearest, value=2.0 / (DRAWS + 1))] * 5).value))


def test_equivalent_ids_are_one_statement(record):
    one = record(causes=(SCALE,), named=[cause("clock_scale", 0.5, sound_speed=0.4, spike=0.1)])
    assert list(scoring.statements(one)) == [(pytest.approx(0.9), True), (0.1, False)]


def test_a_true_cause_is_one_true_statement_in_its_likeliest_place(record):
    alias, first = cause("sound_speed", 0.6, 0.3), cause("clock_scale", 0.9, 0.6)
    twice = record(causes=(SCALE,), named=[alias, first])
    assert sorted(scoring.statements(twice)) == [(0.6, False), (0.9, True)]
    assert list(scoring.wrong_causes(twice)) == [alias]
    assert not scoring.no_wrong_share(twice)
    beside = record(causes=(SCALE,), named=[cause("spike", 0.5, clock_scale=0.4), cause("sound_speed", 0.3)])
    assert sorted(scoring.statements(beside)) == [(0.3, True), (0.4, False), (0.5, False)]
    assert [wrong["effect"] for wrong in scoring.wrong_causes(beside)] == ["spike"]


def test_both_causes_of_a_pair_may_stand_in_one_place(record):
    both = record(causes=(OFFSET, SCALE), named=[cause("zero_offset", 0.6, clock_scale=0.3, spike=0.1)])
    assert sorted(scoring.statements(both)) == [(0.1, False), (0.3, True), (0.6, True)]
    assert not list(scoring.wrong_causes(both))


def test_a_pair_needs_a_cause_for_each(record):
    assert scoring.names_all(record(causes=(OFFSET, SCALE), named=[cause(), cause("sound_speed")]))
    assert not scoring.names_all(record(causes=(OFFSET, SCALE), named=[cause()]))


def test_an_unmodelled_fault_misleads_only_by_a_large_believed_cause(record):
    fault = {"kind": "unmodelled", "causes": (), "fault": "readings breathe"}
    assert scoring.misled(record(**fault))
    assert not scoring.misled(record(**fault, named=[cause(share=0.2)]))
    assert not scoring.misled(record(**fault, named=[cause(probability=0.4)]))


@pytest.mark.parametrize(("change", "effect"), scoring.PARTS.items())
def test_the_effect_that_is_part_of_a_fault_misleads_nobody(record, change, effect):
    bias = "bias of 0.01 as a wave of the angle"
    fault = {"kind": "unmodelled", "causes": (), "fault": f"{bias}; {change} of 0.3 as a box of the time"}
    assert not scoring.misled(record(**fault, named=[cause(effect)]))
    assert scoring.misled(record(**fault, named=[cause(effect), cause("spike")]))
    assert scoring.misled(record(**fault | {"fault": bias}, named=[cause(effect)]))


def test_the_parts_of_faults_are_changes_of_the_grammar_and_effects_of_the_catalogue():
    assert scoring.PARTS.keys() <= AT_ONE.keys()
    assert set(scoring.PARTS.values()) <= CATALOGUE.keys()


def test_separation_is_the_gain_of_a_difference_in_nats(record):
    scores = record()["scores"]
    assert scoring.separation(record()) == pytest.approx(0.5 * 10.0**2)
    for z, apart in ((5.4, False), (5.5, True), (-9.0, False)):  # 15 nats are 5.48 standard errors
        assert scoring.is_apart(record(scores=scores | {"before": 0.002 + 0.001 * z})) == apart
    assert scoring.separation(record(scores=scores | {"gap_error": 0.0})) == 0.0


def test_a_gap_on_unseen_visits_within_two_errors_is_no_figure(record):
    held = record()["verdict"]["held_out"]  # 10 mm from the simulation to the oracle, 9 of them closed
    scores = record()["scores"]
    assert scoring.gap_unseen(record()) == pytest.approx(0.9)
    assert scoring.gap_unseen(record(scores=scores | {"gap_error": 0.0051})) is None
    assert scoring.gap_unseen(record(verdict={"held_out": held | {"repeatability_mm": 13.0}})) is None
    figures = found([record(), record(number=1, scores=scores | {"gap_error": 0.0051})])
    assert figures["unseen visits, strong: median gap closed"].count == "1/2"


def test_scores_within_the_tolerance_are_rows_of_their_own(record):
    scores = record()["scores"]
    near = {name: scores[name] for name in scores if name != "offered"} | {"corrected": 0.007}
    figures = found([record(scores=scores | {"near": near}), record(number=1)])  # an older version has no near scores
    row = figures["model within 10 %, known causes: median gap closed"]
    assert (row.value, row.count) == (pytest.approx(0.5), "1/2")
    assert figures["fresh recording, corrected model, known causes: median gap closed"].value == pytest.approx(0.9)
    assert figures["readings within 10 %: worse than the simulation"].count == "1/2"


def test_no_gap_is_no_figure_and_a_correction_that_harms_is_below_zero(record):
    scores = record()["scores"]
    assert scoring.gap_closed(record(scores=scores | {"before": 0.003})) is None
    worse = record(scores=scores | {"corrected": 0.02})
    assert scoring.gap_closed(worse) < 0
    assert scoring.made_worse(worse)
    assert not scoring.made_worse(record())


def test_the_page_prints_misses_first_and_families_left_out_apart(record):
    wrong = [record("fixed", number=k, named=[cause("spike")]) for k in range(5)]
    hard = record("hard", kind="forty_pings", causes=(), named=[])
    missed = record("hard", kind="ten_marks", causes=())
    content = judged([*[record(number=k) for k in range(5)], *wrong, hard, missed], ("fixed", "driving"))
    page = markdown(content, "made by x", ("fixed", "driving"))
    assert (
        page.index("## Misses")
        < page.index("| strong single: true cause most probable | ≥ 95 % | **50 % (10; 24 % – 76 %)** | **0 % (5;")
        < page.index("## Targets")
    )
    assert "hard: 1 right, 1 wrong" in page
    assert "| hard: ten_marks | 1,000 | none | explained |" in page
    plain = json.loads(json.dumps(as_json(content)))
    lead = {name: next(r for r in plain[name] if "true cause most" in r["metric"]) for name in plain}
    assert (lead["beam"]["hit"], lead["fixed"]["hit"], lead["left out of the fit"]["hit"]) == (True, False, False)


def test_a_real_recording_is_a_row_and_each_change_of_a_half_a_column(record):
    as_it_is = record("real", kind="box: as it is", causes=())
    moved = record("real", kind="box: +12 mm")
    page = markdown(judged([record(), moved, as_it_is], ()), "made by x", ())
    assert "| recording | +12 mm | as it is |" in page
    assert "| box | right | **explained** zero_offset" in page


def test_a_hard_case_is_right_without_a_second_cause(record):
    assert is_right(record("real"))
    assert not is_right(record("real", named=[cause(), cause("spike", 0.6, 0.05)]))
    assert not is_right(record("real", causes=()))
    assert is_right(record("hard", causes=(), named=[]))
