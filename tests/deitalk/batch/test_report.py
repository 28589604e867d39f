"""Rate and time left of a batch."""

from deitalk.batch.report import Pace


def test_pace_counts_from_the_first_result():
    now = [100.0]
    pace = Pace(lines=5, weight=500, clock=lambda: now[0])
    assert pace.text() == "0 of 5 lines"
    now[0] = 150.0  # the model was loaded meanwhile
    pace.add(100, 4.0, failed=False)
    assert pace.text() == "1 of 5 lines"
    pace.add(0, 0.0, failed=False)
    now[0] = 150.1
    assert pace.text() == "2 of 5 lines", "too early for a rate"
    now[0] = 160.0
    pace.add(100, 20.0, failed=True)
    assert pace.share == 0.4
    assert pace.text() == "3 of 5 lines, 1 failed, 0.2 lines/s, 2 x real time, 0:30 left"
