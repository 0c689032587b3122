"""Numbers and sentences: units, signs, singular cases; the fragments are valid and complete."""

import math
import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from noise.discrepancy.locate.power import COMMONEST
from noise.discrepancy.report import markup, words
from noise.discrepancy.report.numbers import bounds, parameter, place, plain, quantity, readable, with_interval
from noise.discrepancy.result import (
    Alternative,
    Aspect,
    BaselineCheck,
    Cause,
    HeldOut,
    Interval,
    Kind,
    Location,
    Measurement,
    PValue,
    Score,
    Unexplained,
    Verdict,
    Visible,
)
from noise.effects import CATALOGUE

UNITS = {effect: p.unit for (effect, name), _ in COMMONEST for p in CATALOGUE[effect].parameters if p.name == name}
P = PValue(0.2, 2000)
INF = float("inf")


def cause(effect="zero_offset", statement="All ranges have an offset of +12.0 mm: a reason.", share=0.9, rivals=()):
    alternatives = tuple(Alternative(*each) for each in rivals)
    return Cause(
        effect, 0.8, alternatives, Interval(share, share - 0.02, share + 0.02, "1"), 400.0, 20.0, {}, statement
    )


def rest(share=0.05, where=()):
    return Unexplained(Interval(share, 0.0, 2 * share, "1"), P, where)


def verdict(causes, share=0.05):
    score, gain = Score(-3.0, 0.01), Interval(0.1, 0.0, 0.2, "1")
    held = HeldOut(100, 10, score, score, score, 0.009, gain)
    check = BaselineCheck(True, P, 1.0)
    return Verdict(Kind.EXPLAINED, "A sentence.", P, (), tuple(causes), rest(share), (), held, (), check)


@given(st.floats(-1e9, 1e9))
def test_a_number_has_no_exponent_and_no_signed_zero(value):
    text = plain(value)
    assert "e" not in text
    assert text not in ("-0", "+0")
    assert float(text.replace(",", "")) == pytest.approx(value, rel=0.05, abs=1e-300)


def test_quantities_have_the_unit_that_suits_their_size():
    assert quantity(0.0123, "m") == "12 mm"
    assert quantity(1.23, "m") == "1.2 m"
    assert quantity(0.015, "1") == "1.5 %"
    assert quantity(24.06, "degC") == "24 °C"
    assert parameter("ka", Interval(4.8, 4.6, 5.0, "1")) == "4.8 (4.6 to 5)"
    assert parameter("probability", Interval(0.048, 0.046, 0.05, "1")) == "4.8 % (4.6 to 5 %)"


def test_a_unit_is_not_repeated_in_the_name_of_a_parameter():
    labels = {readable(p.name, p.unit) for effect in CATALOGUE.values() for p in effect.parameters}
    assert {"offset", "temperature", "rate", "sigma at 6m", "behind", "per metre"} <= labels
    assert not [label for label in labels if label.split()[-1] in ("m", "s", "k", "db", "deg", "c", "h")]


def test_an_interval_shows_its_width():
    assert bounds(Interval(24.1, 23.9, 24.3, "degC")) == "23.9 to 24.3 °C"
    assert with_interval(Interval(0.5, 0.5, 0.5, "m")) == "500 mm (500 to 500 mm)"
    assert with_interval(Interval(0.0, float("nan"), float("nan"), "m")) == "0 mm (interval unknown)"
    assert quantity(float("nan"), "m") == "unknown"


@given(st.floats(1e-4, 1e3), st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.sampled_from(["m", "degC", "1"]))
def test_a_printed_value_lies_within_its_printed_interval(value, below, above, unit):
    printed = with_interval(Interval(value, value * (1.0 - below), value * (1.0 + above), unit))
    middle, low, high = (float(text.replace(",", "")) for text in re.findall(r"[\d.,]+", printed))
    assert low <= middle <= high


def test_a_value_has_the_digits_of_its_interval():
    assert with_interval(Interval(24.6, 24.5, 24.7, "degC")) == "24.6 °C (24.5 to 24.7 °C)"
    found = Location(Aspect.BIAS, {}, Interval(-0.0395, -0.0405, -0.0384, "m"), P)
    assert words.location(found) == "Echoes read 39.5 mm short (38.4 to 40.5 mm) everywhere"


def test_regions_are_words():
    assert place({}) == "everywhere"
    assert (
        place({"distance": (0.7, 2.0), "temperature_c": (20.0, 24.0)})
        == "at 0.7 to 2 m and at temperatures of 20 to 24 °C"
    )
    assert place({"distance": (-INF, 2.0)}) == "at less than 2 m"
    assert place({"load_v": (3.0, 5.0)}) == "where load_v is 3 to 5"
    assert place({"time": (0.0, 600.0)}) == "at times of 0 to 10 min"
    assert place({"time": (86400.0, 864000.0)}) == "at times of 1 to 10 days"


def test_a_region_of_one_value_states_it_once():
    assert place({"run": (1.0, 1.0)}) == "in session 1 (counted from 0)"
    assert place({"period_s": (71.3, 71.3)}) == "with a period of 71.3 s"
    assert place({"distance": (0.7, 0.7)}) == "at 0.7 m"


def test_the_file_states_regions_in_mm_and_degrees():
    region = {"abs_angle": (0.0, math.pi / 6), "movement": (0.0, 0.5), "run": (1, 1)}
    told = replace(verdict([]), where=(Location(Aspect.BIAS, region, Interval(0.01, 0.0, 0.02, "m"), P),)).to_dict()
    assert told["where"][0]["region"] == {"abs_angle_deg": [0.0, 30.0], "movement_mm": [0.0, 500.0], "run": [1.0, 1.0]}


def test_the_least_beam_width_that_shows_is_no_percentage():
    assert words.least(Visible("beam_width", 3.2, "1")) == "3.2"
    assert words.least(Visible("clock_scale", 0.032, "1")) == "3.2 %"


@pytest.mark.parametrize("changed", [*Aspect, *(effect for (effect, _), _ in COMMONEST)])
def test_what_would_have_shown_is_a_noun(changed):
    unit = {**{str(each): each.unit for each in Aspect}, **UNITS}[str(changed)]
    assert re.match(r"a (?!an? )[^aeiou]|[\d.]+ % [a-z]+ readings$", words.visible(Visible(str(changed), 0.02, unit)))


@pytest.mark.parametrize("aspect", Aspect)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_every_aspect_has_a_sentence_in_both_directions(aspect, sign):
    unit = "m" if aspect is Aspect.BIAS else "1"
    text = words.location(
        Location(aspect, {"angle": (0.1, 0.2)}, Interval(sign * 0.02, sign * 0.01, sign * 0.03, unit), P)
    )
    other = words.location(
        Location(aspect, {"angle": (0.1, 0.2)}, Interval(-sign * 0.02, -sign * 0.03, -sign * 0.01, unit), P)
    )
    assert text != other
    assert "-" not in text
    assert text[0].isupper() or text[0].isdigit()
    assert text.endswith("at angles of 5.7 to 11°")


def test_an_interval_that_includes_zero_is_not_printed_as_a_size():
    text = words.location(Location(Aspect.BIAS, {}, Interval(0.002, -0.001, 0.005, "m"), P))
    assert text == "Echoes read 2 mm long everywhere"


def test_half_the_scatter_is_called_half():
    half = Location(Aspect.SPREAD, {}, Interval(-0.375, -0.42, -0.32, "1"), P)  # (0.5^2 - 1) / 2
    assert words.location(half) == "Echoes scatter 50 % less (40 to 60 %) everywhere"
    assert words.least(Visible("spread", 1.5, "1")) == "100 %"


def test_every_effect_has_a_plain_name():
    names = [words.name(effect) for effect in CATALOGUE]
    assert len(set(names)) == len(CATALOGUE)
    assert not any("_" in name for name in names)


@pytest.mark.parametrize("effect", CATALOGUE)
def test_the_symptom_of_every_effect_contains_a_number(effect):
    kind = CATALOGUE[effect]
    made = kind(**{p.name: p.starts[0] for p in kind.parameters if p.starts})
    text = words.symptom(cause(effect, made.statement()))
    assert any(letter.isdigit() for letter in text), text
    assert not text.endswith((".", ":"))


def test_the_headline_holds_the_ambiguity_but_not_improbable_rivals():
    scale = "Readings run long by 1.5 % of distance: the air was at 14 degC."
    found = cause("sound_speed", scale, rivals=[("clock_scale", 0.3), ("thermal_drift", 0.01)])
    assert words.ambiguous(found) == "Readings run long by 1.5 % (15 mm at 1 m): speed of sound or clock?"
    assert words.ambiguous(cause("sound_speed", scale)).endswith("the air was at 14 °C")


def test_summaries_of_every_kind_are_sentences():
    seen = [Visible("zero_offset", 0.002, "m"), Visible("bias", 0.001, "m"), Visible("dropped_reading", 0.02, "1")]
    where = [Location(Aspect.BIAS, {"distance": (1.0, 2.0)}, Interval(0.01, 0.008, 0.012, "m"), P)]
    told = {kind: words.summary_of(kind, [cause()], where, rest(0.3), seen, 1234) for kind in Kind}
    told[Kind.UNEXPLAINED] = words.summary_of(Kind.UNEXPLAINED, [], where, rest(0.3), seen, 1234)
    assert told[Kind.NONE] == (
        "No difference found in 1,234 pings: a zero offset of 2 mm or 2 % lost readings would have shown."
    )
    small = Unexplained(rest().share, PValue(1 / 2001, 2000))
    assert words.summary_of(Kind.NONE, [], [], small, [], 10) == "A difference too small to matter in 10 pings."
    assert told[Kind.EXPLAINED] == "All ranges have an offset of +12.0 mm: a reason."
    assert told[Kind.PARTLY_EXPLAINED].endswith("30 % of the difference remains unexplained.")
    assert told[Kind.UNEXPLAINED] == "Echoes read 10 mm long (8 to 12 mm) at 1 to 2 m: no known effect explains it."
    likely = replace(cause(), probability=0.46)
    assert words.summary_of(Kind.UNEXPLAINED, [likely], where, rest(0.3), seen, 1234).endswith(
        "at 1 to 2 m: zero offset may be the cause, with probability 46 %."
    )
    part = replace(cause(share=0.2), alternatives=(Alternative("time_walk", 0.1),))
    assert words.summary_of(Kind.UNEXPLAINED, [part], where, rest(0.8), seen, 1234).endswith(
        "at 1 to 2 m: zero offset or late detection of weak echoes explains 20 % of the difference, "
        "no known effect the rest."
    )
    assert "Too little data" in told[Kind.TOO_LITTLE_DATA]
    assert words.summary_of(Kind.NONE, [], [], rest(), [], 1) == "No difference found in 1 ping."
    many = words.summary_of(Kind.EXPLAINED, [cause()] * 4, where, rest(), seen, 10)
    assert many.endswith("2 smaller causes beside.")


@pytest.mark.parametrize(("pings", "told"), [(0, ""), (1, ""), (1200, " (1,200 pings)")])
def test_a_measurement_states_its_pings_only_where_there_are_several(pings, told):
    assert words.measurement(Measurement("look at it", ("stuck",), pings)) == f"look at it{told}"


@pytest.mark.parametrize("colour", markup.COLOURS)
def test_white_labels_can_be_read_on_every_colour(colour):
    light = [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    linear = [x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in light]
    luminance = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    assert 1.05 / (luminance + 0.05) >= 4.5  # WCAG 2.1, contrast of text with white


@given(st.lists(st.floats(-0.5, 1.5) | st.just(math.nan), min_size=1, max_size=6), st.floats(0.0, 1.0))
def test_the_bar_never_exceeds_its_width(shares, left):
    drawing = ElementTree.fromstring(markup.share_bar(verdict([cause(share=each) for each in shares], left)))
    boxes = drawing.findall("rect")[1:]
    ends = [float(box.get("x", 0)) + float(box.get("width")) for box in boxes]
    assert len(boxes) == len(shares) + 1
    assert max(ends) <= markup.WIDTH + 0.5
