"""Component specifications in one line of text."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadftc_model.spec import format_spec, parse_spec

FLOATS = st.floats(allow_nan=False)


def test_words_become_a_name_and_values():
    spec = parse_spec("bias channel=attitude axes=roll,pitch value=1deg start=20s")
    assert spec.kind == "bias"
    assert spec.values == {"channel": "attitude", "axes": ["roll", "pitch"], "value": "1deg", "start": "20s"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("rotors=[1]", ["1"]),
        ("rotors=[1,3]", ["1", "3"]),
        ("rotors=[ 1, 3 ]", ["1", "3"]),
        ("rotors=[]", []),
        ("rotors=1,3", ["1", "3"]),
        ("rotors=1", "1"),
    ],
)
def test_list_may_have_brackets_as_in_yaml(text, expected):
    assert parse_spec(f"loss {text} value=0.5").values == {"rotors": expected, "value": "0.5"}


@given(FLOATS, st.lists(FLOATS, min_size=2, max_size=4))
def test_floats_survive_a_round_trip_exactly(number, numbers):
    values = parse_spec(format_spec("kind", {"number": number, "numbers": numbers})).values
    assert float(values["number"]) == number
    assert [float(text) for text in values["numbers"]] == numbers


def test_numpy_floats_are_written_as_numbers():
    assert format_spec("kind", {"a": np.float64(0.1), "b": (np.float64(1.0), 2)}) == "kind a=0.1 b=1.0,2"


def test_other_values_survive_a_round_trip():
    values = {"flag": True, "count": 3, "text": "imu", "axes": ["x", "z"], "size": "0.05 N m"}
    expected = {"flag": "true", "count": "3", "text": "imu", "axes": ["x", "z"], "size": "0.05Nm"}
    assert parse_spec(format_spec("kind", values)).values == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "'': expected a name first"),
        ("   ", "expected a name first"),
        ("value=1", "'value=1': expected a name first"),
        ("bias roll", "'bias roll': 'roll' is no key=value"),
        ("bias =1", "'=1' is no key=value"),
        ("bias value=", "'value=' is no key=value"),
        ("bias value=1 value=2", "'value' is given twice"),
        ("loss rotors=[1", r"'\[1' is no list: expected such as \[1, 2\], or 1,2"),
        ("loss rotors=[1]]", "is no list"),
        ("loss rotors=[[1], 2]", "is no list"),
        ("loss rotors=1]", "is no list"),
    ],
)
def test_wrong_specification_is_refused_with_the_word(text, message):
    with pytest.raises(ValueError, match=message):
        parse_spec(text)
