"""What pages say that commands print is renewed digit by digit."""

import pytest

from tools.printed import agree, renewed

LINE = "error: x -0.06 mm (z +0.3 mm), within ±5 mm"


def test_a_line_gets_the_numbers_of_the_run_with_its_own_decimals() -> None:
    said = "other 1\nerror: x +0.376 mm\n(z -0.25 mm), within ±5 mm\n"
    assert renewed(LINE, said) == "error: x +0.38 mm (z -0.2 mm), within ±5 mm"
    assert renewed("[1.0 -2.0]", "[ 1.26\n  -3.14 ]") == "[1.3 -3.1]"
    with pytest.raises(ValueError, match="nothing prints"):
        renewed(LINE, "error: y -0.06 mm")


def test_the_last_digit_counts_and_a_standard_deviation_may_differ_by_a_tenth() -> None:
    assert agree(LINE, LINE, exact=True)
    assert not agree(LINE, LINE.replace("-0.06", "-0.07"), exact=True)
    assert agree(LINE, LINE.replace("-0.06", "+0.90"), exact=False)
    assert not agree(LINE, LINE.replace("-0.06", "+0.96"), exact=False)
    assert not agree(LINE, LINE.replace("within", "outside"), exact=False)
    row = "<tr><th>1 σ, mm</th><td>+{}</td></tr>x +0.11 ± {}, inside"
    assert agree(row.format("1.00", "0.93"), row.format("1.09", "1.00"), exact=True)
    assert not agree(row.format("1.00", "0.93"), row.format("1.12", "0.93"), exact=True)
    assert not agree(row.format("1.00", "0.93"), row.format("1.00", "0.35"), exact=True)
