"""Units: known factors, both ways, and no guess where a spelling has two meanings."""

import math
import string

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from split_cli.errors import MapError
from split_cli.signals import CHANNELS, REQUIRED_CHANNELS, UNITS, convert_to_si, find_unit, split_name_and_unit

# From the definitions: the international mile is 1609.344 m, the pound 0.45359237 kg, standard gravity 9.80665.
KNOWN = [
    ("km/h", 36.0, 10.0),
    ("kmph", 36.0, 10.0),
    ("kph", 36.0, 10.0),
    ("KPH", 36.0, 10.0),
    ("mph", 1.0, 1609.344 / 3600.0),
    ("kn", 1.0, 1852.0 / 3600.0),
    ("g", 1.0, 9.80665),
    ("G", 1.0, 9.80665),
    ("m/s²", 1.0, 1.0),
    ("m/s^2", 1.0, 1.0),
    ("m/s**2", 1.0, 1.0),
    ("m·s⁻²", 1.0, 1.0),
    ("deg", 180.0, math.pi),
    ("°", 180.0, math.pi),
    ("deg/s", 90.0, math.pi / 2.0),
    ("dps", 90.0, math.pi / 2.0),
    ("rpm", 60.0, 2.0 * math.pi),
    ("Nm", 7.0, 7.0),
    ("N·m", 7.0, 7.0),
    ("lbf ft", 1.0, 0.45359237 * 9.80665 * 0.3048),
    ("psi", 1.0, 0.45359237 * 9.80665 / 0.0254**2),
    ("kPa", 2.0, 2e3),
    ("bar", 2.0, 2e5),
    ("%", 50.0, 0.5),
    ("degC", 20.0, 293.15),
    ("ms", 250.0, 0.25),
    ("µs", 250.0, 250e-6),  # U+00B5, the micro sign
    ("μs", 250.0, 250e-6),  # U+03BC, the Greek letter; both occur in headers
    ("MPa", 1.0, 1e6),
]


@pytest.mark.parametrize(("unit", "raw", "si"), KNOWN)
def test_known_factor(unit, raw, si):
    # 1e-6 relative: the table holds factors to seven digits or better.
    assert convert_to_si(np.array([raw]), unit)[0] == pytest.approx(si, rel=1e-6)


@pytest.mark.parametrize("spelling", ["mPa", "Kn", "KN", "rps", "rads", "degs", "Ms", "M", "MN"])
def test_a_spelling_with_two_meanings_is_refused(spelling):
    # mPa or MPa (a factor of 1e9), knots or kilonewton, revolutions or radians a second, radians or rad/s,
    # millisecond or megasecond, metre or mega: never guessed.
    assert find_unit(spelling) is None
    with pytest.raises(MapError):
        convert_to_si(np.zeros(1), spelling)


def test_the_refusal_of_a_double_meaning_names_both():
    with pytest.raises(MapError, match="rad/s") as caught:
        convert_to_si(np.zeros(1), "rps")
    assert "rpm" in str(caught.value)


def test_an_unknown_unit_names_the_place_and_the_nearest():
    with pytest.raises(MapError) as caught:
        convert_to_si(np.zeros(1), "kmh/", where="map.yaml, vx")
    assert str(caught.value).startswith("map.yaml, vx: unknown unit 'kmh/'")
    assert "km/h" in str(caught.value)


def test_a_unit_of_another_quantity_is_refused():
    with pytest.raises(MapError, match="deg is a unit of rad, vx is in m/s"):
        convert_to_si(np.zeros(1), "deg", expected="m/s", where="vx(deg)", channel="vx")
    assert convert_to_si(np.array([3.6]), "km/h", expected="m/s")[0] == pytest.approx(1.0, rel=1e-12)


@given(
    symbol=st.sampled_from([unit.symbol for unit in UNITS]),
    values=st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=5),
)
def test_there_and_back(symbol, values):
    unit = find_unit(symbol)
    si = convert_to_si(np.array(values), symbol)
    back = (si - unit.offset) / unit.factor
    # Two roundings of a product and, for degC, of a sum with 273.15.
    np.testing.assert_allclose(back, values, rtol=1e-14, atol=1e-12 * max(1.0, 1.0 / unit.factor) * 1e-1)


@given(st.sampled_from([unit.symbol for unit in UNITS]), st.sampled_from(["({})", "[{}]", " ({})", " [ {} ] "]))
def test_a_header_with_a_bracketed_unit_gives_name_and_unit(symbol, form):
    assume((symbol, form) != ("1", "[{}]"))  # an element of an array, see below
    name, unit = split_name_and_unit("some channel" + form.format(symbol))
    assert name == "some channel"
    assert unit == symbol


def test_a_number_in_a_bracket_right_behind_a_name_is_an_index():
    assert split_name_and_unit("q[1]") == ("q[1]", None)
    assert split_name_and_unit("throttle [1]") == ("throttle", "1")


@given(st.text(alphabet=string.ascii_letters + string.digits + "_/. ", min_size=1, max_size=20))
def test_any_header_gives_a_name_that_is_part_of_it(header):
    name, unit = split_name_and_unit(header)
    assert name in header
    assert unit is None or find_unit(unit) is not None


def test_unit_symbols_find_themselves():
    for unit in UNITS:
        assert find_unit(unit.symbol) is unit


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("vx(m/s)", "vx", "m/s"),
        ('# "Ground Speed" [km/h]', "Ground Speed", "km/h"),
        ('"Ground Speed [km/h]"', "Ground Speed", "km/h"),
        ("vx_mps", "vx_mps", "m/s"),
        ("yaw_rate_radps", "yaw_rate_radps", "rad/s"),
        ("yaw_rate_deg_s", "yaw_rate_deg_s", "deg/s"),
        ("vy_cm_s", "vy_cm_s", "cm/s"),
        ("vx_km_h", "vx_km_h", "km/h"),
        ("ax_m_s2", "ax_m_s2", "m/s^2"),
        ("vx_m_s", "vx_m_s", "m/s"),
        ("torque_Nm", "torque_Nm", "N m"),
        ("pressure_kPa", "pressure_kPa", "kPa"),
        ("t", "t", None),
        ("t_ms", "t_ms", "ms"),
        ("header_timestamp_ms", "header_timestamp_ms", "ms"),
        ("status", "status", None),
        ("items", "items", None),
        ("vx ()", "vx", None),
        ("(m/s)", "(m/s)", None),
        ("x(furlong)", "x", "furlong"),
        ("ratio(-)", "ratio", "1"),
    ],
)
def test_headers_of_the_field(header, name, unit):
    assert split_name_and_unit(header) == (name, unit)


def test_a_suffix_that_may_be_milliseconds_or_metres_a_second_says_nothing():
    # vx_ms is a speed in one log and t_ms a time in another; what is not said is not guessed.
    assert split_name_and_unit("vx_ms") == ("vx_ms", None)


def test_si_values_pass_unchanged_and_integers_become_float():
    values = np.array([1, 2, 3])
    out = convert_to_si(values, "m/s")
    assert out.dtype == np.float64
    np.testing.assert_array_equal(out, values)


def test_every_channel_is_in_an_si_unit_of_the_table():
    for channel in CHANNELS.values():
        unit = find_unit(channel.unit)
        assert (unit.factor, unit.offset) == (1.0, 0.0)
    assert set(REQUIRED_CHANNELS) <= set(CHANNELS)
