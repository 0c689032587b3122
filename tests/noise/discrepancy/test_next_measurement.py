"""What to measure next: each thing once, with all that it tells apart."""

from noise.discrepancy.next_measurement import Measurement, merged


def test_the_same_measurement_is_asked_for_once():
    asked = [
        Measurement("log a thermometer", ("drift", "clock"), 1),
        Measurement("go to 6 m", ("drift", "offset"), 30),
        Measurement("log a thermometer", ("drift", "speed"), 4),
    ]
    assert merged(asked) == [
        Measurement("log a thermometer", ("drift", "clock", "speed"), 4),
        Measurement("go to 6 m", ("drift", "offset"), 30),
    ]
