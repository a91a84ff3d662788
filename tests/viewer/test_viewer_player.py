"""Play, pause, speed, cycles."""

import numpy as np

from fastmimic.viewer.viewer import Player


def _clock() -> Player:
    return Player(rows=1000, rate_hz=500.0, cycle_starts=np.array([0, 300, 600, 900]))


def test_it_moves_at_the_speed_asked_for() -> None:
    clock = _clock()
    for _ in range(10):
        clock.advance(0.02)
    assert clock.row == 100
    clock.speed = 0.1
    clock.advance(0.02)
    assert clock.row == 101
    clock.toggle()
    clock.advance(1.0)
    assert clock.row == 101


def test_at_the_end_it_does_what_was_chosen() -> None:
    clock = _clock()
    clock.seek(990)
    clock.advance(0.1)
    assert clock.row == 40
    clock.repeat = "off"
    clock.seek(990)
    clock.advance(0.1)
    assert (clock.row, clock.playing) == (999, False)
    clock.toggle()
    assert (clock.row, clock.playing) == (0, True)
    clock.repeat = "cycle"
    clock.seek(590)
    clock.advance(0.1)
    assert (clock.row, clock.cycle) == (340, 1)


def test_cycles_are_stepped_through() -> None:
    clock = _clock()
    rows = []
    for by in (1, 1, 1, 1, -1, -1, -1, -1):
        clock.step_cycle(by)
        rows.append(clock.row)
    assert rows == [300, 600, 900, 900, 600, 300, 0, 0]
    clock.seek(-4)
    assert clock.row == 0
    clock.seek(10**6)
    assert clock.row == 999
    assert clock.cycle_rows(3) == (900, 1000)
