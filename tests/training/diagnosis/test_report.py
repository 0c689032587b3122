"""The report and the notebook view in ten situations: complete pages, plain words, figures that fit the recording."""

import html
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from acquisition import Ping, Reading, Recording
from noise.discrepancy.result import Aspect, BaselineCheck, Interval, Kind, Location, PValue
from noise.fitting.batch import Batch
from noise.model import order_of
from training.diagnosis.diagnose import summary
from training.diagnosis.figures import Compared, overview, scores
from training.diagnosis.prediction import Prediction, along, binned, column, observed, thinned
from training.diagnosis.report import fit_rows, p_text, render, tiles, worst_pings

DIFFER = ["scale", "clutter", "dropped", "unexplained", "partly", "drift", "silent", "robot"]
NAMES = ["none", "trifle", "too_little", *DIFFER]
P = PValue(1 / 2001, 2000)


@pytest.fixture(scope="session")
def pages(situations):
    return {name: render(made, "result/corrected") for name, made in situations.items()}


def text_of(page):
    """Return the visible text of a page."""
    bare = re.sub(r"<(style|svg|title|pre).*?</\1>", " ", page, flags=re.S)
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", bare)))


@pytest.mark.parametrize("name", NAMES)
def test_a_page_is_one_file_without_scripts(pages, name):
    page = pages[name]
    assert len(page) < 1_500_000
    assert "<script" not in page
    links = [part.split('"')[0] for part in page.split('href="')[1:] + page.split('src="')[1:]]
    assert all(link.startswith(("#", "data:")) for link in links)


@pytest.mark.parametrize("name", NAMES)
def test_what_scrolls_can_be_reached_with_the_keyboard(pages, name):
    scrolling = re.findall(r'<(?:pre|div class="scroll")[^>]*>', pages[name])
    assert all('tabindex="0"' in tag for tag in scrolling)


@pytest.mark.parametrize("name", NAMES)
def test_every_figure_has_words_and_every_table_a_header(pages, name):
    page = pages[name]
    assert all('role="img" aria-label="' in tag for tag in re.findall(r"<svg[^>]*>", page))
    assert all(start == "<tr><th" for start in re.findall(r"<table[^>]*>(.{7})", page, flags=re.S))


@pytest.mark.parametrize("name", NAMES)
def test_a_page_has_no_jargon_above_the_details_and_no_broken_text(pages, name):
    text = text_of(pages[name])
    above = text.split(" Details ")[0]
    assert "nats" not in above
    assert "p =" not in above
    for broken in ("+0 mm", "-0 ", "nan", "None", "e-0", "..", " .", " ,", "degC", "{{", "_"):
        assert broken not in above.replace("recorded.csv", "").replace("verdict.json", ""), (broken, name)
    assert "p = 0.0005" not in text


@pytest.mark.parametrize("name", NAMES)
def test_the_identifiers_of_all_figures_of_a_page_differ(pages, name):
    found = [set(re.findall(r'id="([^"]+)"', svg)) for svg in pages[name].split("<svg")[1:]]
    clips = [{each for each in ids if re.fullmatch(r"p[0-9a-f]{10}", each)} for ids in found]
    assert sum(map(len, clips)) == len(set().union(*clips))


def test_the_ambiguity_is_in_the_headline(pages):
    expected = "Readings run long by 1.5 % (15 mm at 1 m): speed of sound, clock or thermal drift?"
    assert expected in text_of(pages["scale"])


def test_the_next_measurement_says_what_it_separates(pages):
    assert "(60 pings). This separates speed of sound and clock." in text_of(pages["scale"])


def test_shares_and_their_intervals_are_listed(pages):
    text = text_of(pages["partly"])
    assert "zero offset: 55 % (52 to 58 %)" in text
    assert "unexplained: 24 % (21 to 27 %)" in text


def test_a_verdict_without_difference_says_what_would_have_shown(pages):
    text = text_of(pages["none"])
    assert "a zero offset of 1.2 mm or 1.1 % lost readings would have shown" in text
    assert "What could have been seen" in text
    assert "What explains the difference" not in text
    assert "beyond the believed causes" not in text
    assert "beyond the believed causes" in text_of(pages["scale"])


def test_a_difference_within_the_tolerance_is_shown_with_the_tolerance(pages, situations):
    text = text_of(pages["trifle"])
    assert "A difference too small to matter" in text
    expected = "Echoes read 1 mm long (0.8 to 1.2 mm) at 1.5 to 3 m: two recordings of one sonar may differ by 2 mm."
    assert expected in text
    assert "What explains the difference" not in text
    axes = overview(situations["trifle"]).axes[0]
    assert any(each.get_text() == "located here" for each in axes.get_legend().get_texts())


def test_a_correction_is_offered_only_if_there_is_one(pages):
    assert "Use the correction" in pages["scale"]
    assert 'diagnosis.save("result")' in pages["scale"].replace("&#34;", '"')  # nobody wrote it there
    assert "Use the correction" not in pages["unexplained"]
    assert "No correction is offered" in text_of(pages["unexplained"])


def test_a_correction_without_a_believed_cause_is_not_composed(situations):
    made = situations["scale"]
    doubtful = BaselineCheck(False, P, 0.9, "the emulator does not fully describe the simulation")
    page = render(replace(made, verdict=replace(made.verdict, causes=(), baseline_check=doubtful)), "result/corrected")
    assert "Use the correction" in page
    assert "noise.compose" not in page
    assert "The emulator does not fully describe the simulation. The results may" in text_of(page)


def test_only_silence_gives_a_short_page_that_says_what_to_check(pages):
    text = text_of(pages["silent"])
    assert "No ping had an echo" in text
    assert "<svg" not in pages["silent"]


def test_warnings_come_before_the_verdict(pages, situations):
    text = text_of(pages["too_little"])
    assert text.index("Only 2 positions") < text.index("Too little data")
    assert situations["too_little"].summary().splitlines()[0].startswith("warning: Only 2 positions")


@pytest.mark.parametrize(
    ("name", "label"), [("drift", "time since"), ("unexplained", "angle"), ("clutter", "distance")]
)
def test_a_mismatch_is_drawn_along_the_condition_where_it_was_located(situations, name, label):
    made = situations[name]
    axes = overview(made).axes[0]
    assert label in axes.get_xlabel()
    assert any(text.get_text() == "located here" for text in axes.get_legend().get_texts())


@pytest.mark.parametrize("name", NAMES)
def test_plot_is_a_figure_and_the_views_are_text(situations, name):
    made = situations[name]
    assert isinstance(made.plot(), Figure)
    assert "\n" not in repr(made)
    assert made.verdict.verdict.value in repr(made)
    assert len(made.summary().splitlines()) <= 11
    assert made._repr_html_().count("<div") == made._repr_html_().count("</div>")


def test_save_and_report_write_files_and_remove_an_older_model(situations, tmp_path):
    situations["scale"].save(tmp_path)
    assert (tmp_path / "verdict.json").is_file()
    assert (tmp_path / "corrected" / "model.json").is_file()
    assert "diagnosis.save(" not in situations["scale"].report(tmp_path / "report.html").read_text()
    situations["unexplained"].save(tmp_path)
    assert not (tmp_path / "corrected").exists()
    assert situations["silent"].report(tmp_path / "report.html").read_text().startswith("<!doctype html>")


def test_the_corrected_model_removes_the_error_that_the_figures_show(situations):
    compared = Compared.of(situations["scale"])
    before, after = (np.nanmedian(np.abs(each.error_mm)) for each, *_ in compared.each)
    assert before > 15
    assert after < 3


def test_predicted_shares_are_calibrated(situations):
    batch = thinned(situations["clutter"].recorded)
    prediction = Prediction.of(situations["clutter"].corrected, batch)
    for aspect in (Aspect.EARLY, Aspect.LATE, Aspect.DETECTION, Aspect.REPEAT):
        share, expected = observed(batch, aspect).mean(), prediction.probability(aspect).mean()
        assert share == pytest.approx(expected, abs=0.03), aspect


def test_the_worst_pings_are_those_that_the_simulation_excludes(situations):
    table = worst_pings(situations["clutter"])
    reading = table["header"].index("reading (mm)")
    assert len(table["rows"]) == 10
    assert all(680 < float(row[reading]) < 720 for row in table["rows"])


@pytest.mark.parametrize("name", NAMES)
def test_what_the_terminal_states_stands_on_the_page(situations, pages, name, tmp_path):
    page = text_of(pages[name])
    said = " ".join(summary(situations[name], tmp_path)[:-1])  # the last line names files
    assert [value for value in re.findall(r"[\d.,]+ (?:mm|m|%|pings)(?!\w)", said) if value not in page] == []


@pytest.mark.parametrize("name", ["scale", "unexplained", "partly"])
def test_bars_and_table_of_scores_use_the_same_words(situations, name):
    made = situations[name]
    axes = Figure().add_subplot()
    scores(axes, made.verdict, made.corrected is not None)
    bars = [label.get_text() for label in axes.get_yticklabels()][::-1]
    rows = [row[0] for row in fit_rows(made.verdict.held_out, made.corrected is not None)]
    assert len(bars) == len(rows)
    assert all(bar in row for bar, row in zip(bars, rows, strict=True))


def test_the_column_is_the_most_restricted_one_that_varies():
    ping = Ping.of(np.linspace(1, 2, 50), angle=np.linspace(0, 0.5, 50), time=np.arange(50.0), temperature_c=20.0)
    batch = Batch.of(Recording.of(ping, Reading.of(ping.distance)))
    size = Interval(0.01, 0.0, 0.02, "m")
    region = {"temperature_c": (10.0, 20.0), "angle": (0.0, 0.1), "distance": (1.0, 1.9)}
    assert along(Location(Aspect.BIAS, region, size, P), batch) == "angle"
    assert along(Location(Aspect.BIAS, {}, size, P), batch) == "distance"
    assert column(batch, "temperature_c") is None
    assert column(batch, "unknown") is None


def test_columns_of_the_past_are_what_came_before_each_ping():
    ping = Ping.of([1.0, 1.0, 1.0, 2.0, 2.0, 2.0], time=np.arange(6.0))
    batch = Batch.of(Recording.of(ping, Reading.of([1.0, 0.0, 0.5, 2.0, 3.0, 2.0])))
    nan = np.nan
    assert column(batch, "order").tolist() == [0, 1, 1, 0, 1, 1]  # the second and third ping are one group
    np.testing.assert_array_equal(column(batch, "previous_reading"), [nan, 0, -2, -1, 0, 1])
    np.testing.assert_array_equal(column(batch, "movement"), [nan, 0, 0, 1000, 0, 0])
    found = Location(Aspect.BIAS, {"period_s": (4.0, 4.0)}, Interval(0.01, 0.0, 0.02, "m"), P)
    assert column(batch, "period_s", found).tolist() == [0, 1, 2, 3, 0, 1]


PAST = {
    "order": ("scale", (0.0, 0.5), "earlier pings of the visit (at least)"),
    "previous_reading": ("clutter", (-1.0, -0.5), "what the ping before read"),
    "movement": ("robot", (0.001, 0.03), "change of distance since the last echo (mm)"),
    "period_s": ("drift", (450.0, 450.0), "time within the period (s)"),
}


@pytest.mark.parametrize("name", PAST)
@pytest.mark.parametrize("aspect", [Aspect.BIAS, Aspect.DETECTION])
def test_a_mismatch_of_the_past_is_drawn_along_the_past(situations, name, aspect):
    situation, between, label = PAST[name]
    made = situations[situation]
    found = Location(aspect, {name: between}, Interval(0.01, 0.008, 0.012, aspect.unit), P)
    axes = overview(replace(made, verdict=replace(made.verdict, where=(found,)))).axes[0]
    assert axes.get_xlabel() == label
    assert min(len(line.get_xdata()) for line in axes.lines[1:]) > 2
    shaded = [text.get_text() for text in axes.get_legend().get_texts()].count("located here")
    assert shaded == (name != "period_s")  # a wave is nowhere


def test_a_thinned_recording_knows_the_order_of_its_pings():
    ping = Ping.of(np.repeat(np.linspace(0.5, 2.0, 4000), 4), time=np.arange(16_000.0))
    kept = thinned(Batch.of(Recording.of(ping, Reading.of(ping.distance)))).ping
    assert 9_000 < len(kept) <= 10_000
    np.testing.assert_array_equal(order_of(kept), kept.time % 4)


def test_a_mismatch_to_either_side_is_drawn_along_the_angle():
    ping = Ping.of(np.linspace(1, 2, 50), angle=np.linspace(-0.5, 0.5, 50))
    batch = Batch.of(Recording.of(ping, Reading.of(ping.distance)))
    found = Location(Aspect.BIAS, {"abs_angle": (0.2, 0.5)}, Interval(0.01, 0.0, 0.02, "m"), P)
    assert along(found, batch) == "abs_angle"
    np.testing.assert_allclose(column(batch, "abs_angle"), np.abs(np.rad2deg(ping.angle)), atol=1e-5)


def test_a_caption_names_the_condition_only_where_the_figure_shows_it(pages):
    assert "Along the condition where they differ" in pages["scale"]
    assert "Along the condition where they differ" not in pages["dropped"]  # it differs everywhere


def test_a_logged_column_does_not_replace_a_condition_of_its_name():
    ping = Ping.of(np.linspace(1, 2, 50), angle=np.linspace(0, 0.5, 50), time=np.arange(50.0))
    named = {"angle": np.linspace(40.0, 10.0, 50), "load_v": np.linspace(3.0, 5.0, 50)}
    batch = Batch.of(Recording.of(replace(ping, covariates=named), Reading.of(ping.distance)))
    np.testing.assert_allclose(column(batch, "angle"), np.rad2deg(ping.angle), atol=1e-5)
    np.testing.assert_allclose(column(batch, "load_v"), named["load_v"], atol=1e-5)


def test_few_values_are_drawn_one_by_one_and_unknown_ones_not_at_all():
    x = np.array([0.0, 9.0, 18.0, 27.0, np.nan])
    centre, mean = binned(np.repeat(x, 30), np.repeat(x + 1.0, 30), np.mean)
    assert centre.tolist() == [0, 9, 18, 27]
    assert mean.tolist() == [1, 10, 19, 28]


def test_bins_have_equal_counts_and_keep_the_mean():
    x, y = np.arange(96.0), np.arange(96.0)
    centre, mean = binned(x, y, np.mean)
    assert len(centre) == 24
    np.testing.assert_allclose(centre, mean)


def test_p_values_end_where_the_bootstrap_ends():
    assert p_text(P) == "p < 0.0005"
    assert p_text(PValue(0.034, 2000)) == "p = 0.034"
    assert p_text(PValue(1e-6, 0)) == "p < 1e-06"
    assert PValue(0.0015, 666, 30, 9).meaning == "max over 30 regressors x 9 aspects, resolution 1 / 667"


def test_the_first_numbers_fit_the_verdict(situations):
    titles = {name: [title for title, *_ in tiles(made)] for name, made in situations.items()}
    assert "Explained" in titles["scale"]
    assert "Unexplained" in titles["unexplained"]
    assert "Explained" not in titles["none"]
    assert situations["none"].verdict.verdict is Kind.NONE


def test_a_notebook_prints_two_lines_of_a_diagnosis(situations):
    for made in situations.values():
        assert len(repr(made)) <= 200
        assert len(repr(made.verdict)) <= 200
