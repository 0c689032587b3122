"""Plans in TOML files: content and error messages."""

import contextlib
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import SettingError
from acquisition.survey.plan import PLANS, SurveyPlan
from acquisition.survey.planfile import find_plan, load_plan
from acquisition.survey.quantities import SWEEPS

MINIMAL = "distances_mm = [300]\nangles_deg = [0]\n"


def plan_of(tmp_path, text):
    path = tmp_path / "p.toml"
    path.write_text(text, encoding="utf-8")
    return load_plan(path)


def test_a_file_can_set_every_field_of_a_plan(tmp_path):
    text = """
    distances_mm = {from = 200, to = 1000, step = 200}
    angles_deg = [0, 2.5]
    reflectances = [0.9]
    incidences_deg = [0, 10]
    pings = 20
    interval_s = 0.1
    move_s = 5
    facing = false
    order = "walk"
    seed = 3
    [sweep]
    gain = {from = 0, to = 31, step = 1}
    height_mm = [500, 1500]
    """
    assert plan_of(tmp_path, text) == SurveyPlan(
        angles_deg=(0.0, 2.5),
        distances_mm=(200.0, 400.0, 600.0, 800.0, 1000.0),
        reflectances=(0.9,),
        pings=20,
        interval_s=0.1,
        move_s=5,
        incidences_deg=(0.0, 10.0),
        order="walk",
        seed=3,
        sweep={"gain": tuple(float(g) for g in range(32)), "height_mm": (500.0, 1500.0)},
    )


def test_the_file_in_the_documentation_is_a_plan(tmp_path):
    manual = (Path(__file__).parents[3] / "docs" / "how-to" / "survey.md").read_text(encoding="utf-8")
    plan = plan_of(tmp_path, manual.split("```toml\n")[1].split("```")[0])
    assert set(plan.sweep) == set(SWEEPS)
    assert plan.distances_mm[-1] == 3000.0


def test_a_short_file_has_the_default_values(tmp_path):
    assert plan_of(tmp_path, MINIMAL) == SurveyPlan(angles_deg=(0.0,), distances_mm=(300.0,))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("distances_mm = [300]", "angles_deg: is missing; a plan needs distances_mm and angles_deg"),
        (MINIMAL + "pigns = 3", "pigns: unknown key, expected one of angles_deg, distances_mm"),
        (MINIMAL + 'pings = "3"', "pings: expected a whole number, got '3'"),
        (MINIMAL + "pings = true", "pings: expected a whole number, got True"),
        (MINIMAL + "pings = 0", "pings: expected a whole number from 1 to"),
        (MINIMAL + "facing = 1", "facing: expected true or false, got 1"),
        (MINIMAL + "reflectances = [1.5]", "reflectances: expected a number from 0 to 1, got 1.5"),
        (MINIMAL + "reflectances = 0.5", r"reflectances: expected a list of numbers or {from, to, step}, got 0.5"),
        (MINIMAL + "incidences_deg = ['x']", "incidences_deg: expected a finite number, got 'x'"),
        (MINIMAL + "reflectances = {from = 0, to = 1}", r"reflectances: expected {from, to, step}"),
        (MINIMAL + "reflectances = {from = 0, to = 1, step = 0}", "reflectances.step: expected a number above 0"),
        (MINIMAL + "reflectances = {from = 1, to = 0, step = 0.1}", "reflectances: expected a range of 1 to"),
        (MINIMAL + "reflectances = {from = 0, to = 1, step = 1e-12}", "reflectances: expected a range of 1 to"),
        (MINIMAL + "reflectances = {from = 0, to = 1, step = 1e-320}", "reflectances: expected a range of 1 to"),
        (MINIMAL + "reflectances = {from = -1e308, to = 1e308, step = 1}", "reflectances: expected a range of 1 to"),
        (MINIMAL + "sweep = 3", "sweep: expected a table of quantities, got 3"),
        (MINIMAL + "[sweep]\ngain = [32]", "sweep.gain: expected a whole number from 0 to 31, got 32"),
        (MINIMAL + "[sweep]\nvolts = [5]", "sweep.volts: no such quantity, expected one of height_mm"),
        (MINIMAL + f"reflectances = [{10**400}]", "reflectances: expected a finite number, got 1000"),
        (
            MINIMAL + "reflectances = {from = 0, to = inf, step = 1}",
            "reflectances.to: expected a finite number, got inf",
        ),
        (
            MINIMAL + "reflectances = {from = 0, to = nan, step = 1}",
            "reflectances.to: expected a finite number, got nan",
        ),
        (MINIMAL + f"pings = {2**20_000:#x}", "pings: expected a whole number from 1 to .*, got int that is too long"),
        (MINIMAL + f"order = {2**20_000:#x}", "order: expected text, got int that is too long"),
        (MINIMAL + "pings = " + "9" * 5000, "not TOML: "),
        (MINIMAL + "pings = " + "[" * 3000 + "]" * 3000, "not TOML: "),
        ("angles_deg = [", "not TOML: "),
    ],
)
def test_an_error_names_file_key_value_and_limit(tmp_path, text, message):
    with pytest.raises(SettingError, match=rf"p\.toml[,:] {message}") as caught:
        plan_of(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_plans_are_found_by_name_or_path(tmp_path):
    assert find_plan("vertical") is PLANS["vertical"]
    with pytest.raises(
        SettingError,
        match=r"plan 'verticle': expected one of quick, .*, or the path of a .toml file; did you mean vertical",
    ):
        find_plan("verticle")
    with pytest.raises(SettingError, match=r"no.toml: cannot be read: No such file or directory; give a plan"):
        find_plan(str(tmp_path / "no.toml"))


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text("ab1.", max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["from", "to", "step"]), inner),
    max_leaves=5,
)


def toml(value):
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k} = {toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(toml(v) for v in value) + "]"
    if isinstance(value, bool) or value is None:
        return str(bool(value)).lower()
    return f"'{value}'" if isinstance(value, str) else repr(value)


@given(st.dictionaries(st.sampled_from(sorted(SurveyPlan.__dataclass_fields__)), VALUES, max_size=4))
def test_any_content_is_a_plan_or_a_setting_error(tmp_path_factory, content):
    text = MINIMAL + "\n".join(f"{k} = {toml(v)}" for k, v in content.items() if k not in MINIMAL)
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return
    path = tmp_path_factory.mktemp("p") / "p.toml"
    path.write_text(text, encoding="utf-8")
    message = str(path)
    with contextlib.suppress(SettingError):
        try:
            load_plan(path)
        except SettingError as error:
            message = str(error)
            raise
    assert message.startswith(str(path))
