"""Every transition of a leg's state machine, step by step at 500 Hz."""

import numpy as np
import pytest

from control.bodies import body
from fastmimic.base.conventions import GRAVITY
from fastmimic.control.config import ControllerConfig, GaitConfig, pack_config
from fastmimic.control.stance import plan_leg
from fastmimic.robot.state import MEMORY

WEIGHT = 100.0  # N
LOADED, FREE, BETWEEN = 30.0, 0.0, 5.0  # N, about the thresholds of 10 N and 2 N
DT = 0.002
SETTINGS = GaitConfig(
    planner="full",
    contact_threshold=0.1,
    release_threshold=0.02,
    min_switch_time=0.1,
    early_takeoff_time=0.04,
)

pytestmark = pytest.mark.nojit


class Leg:
    """The rear-right leg of a robot that has been in its state for long."""

    INDEX = 2

    def __init__(self, stance: bool, settings: GaitConfig = SETTINGS, asked: float = LOADED) -> None:
        self.config = pack_config(ControllerConfig(rate_hz=1 / DT, gait=settings), body(WEIGHT / GRAVITY))
        self.memory = np.zeros(1, MEMORY)
        self.memory["stance"][0, self.INDEX] = stance
        self.memory["since_switch"][0, self.INDEX] = 1e3
        self.memory["force"][0, self.INDEX, 2] = asked

    def step(self, wanted: bool, force: float, swung: float = 0.7) -> bool:
        return plan_leg(self.config[0], self.memory[0], self.INDEX, wanted, 0.0 if wanted else swung, force)

    def run(self, duration: float, wanted: bool, force: float) -> int:
        """Number of lift-offs within a time."""
        return sum(self.step(wanted, force) for _ in range(round(duration / DT)))

    def time_to_switch(self, wanted: bool, force: float, limit: float = 1.0) -> float:
        """Time until the state changes under constant schedule and force; inf if it does not."""
        before = self.stance
        for i in range(round(limit / DT)):
            self.step(wanted, force)
            if self.stance != before:
                return (i + 1) * DT
        return np.inf

    @property
    def stance(self) -> bool:
        return bool(self.memory["stance"][0, self.INDEX])

    @property
    def early_touchdowns(self) -> int:
        return int(self.memory["early_touchdowns"][0])


def swinging_for(duration: float) -> Leg:
    leg = Leg(stance=True)
    assert leg.step(wanted=False, force=LOADED)
    leg.run(duration, wanted=False, force=FREE)
    assert not leg.stance
    return leg


class TestScheduled:
    def test_takeoff_happens_when_the_schedule_says_so_loaded_or_not(self) -> None:
        for force in (LOADED, FREE):
            leg = Leg(stance=True)
            leg.run(0.2, wanted=True, force=LOADED)
            assert leg.step(wanted=False, force=force), "lift-off is reported"
            assert not leg.stance

    def test_lift_off_is_reported_once(self) -> None:
        leg = Leg(stance=True)
        assert leg.run(0.3, wanted=False, force=FREE) == 1

    def test_touch_down_happens_when_the_schedule_says_so_though_nothing_is_felt(self) -> None:
        leg = swinging_for(0.2)
        assert not leg.step(wanted=True, force=FREE), "touch-down is no lift-off"
        assert leg.stance
        assert leg.early_touchdowns == 0

    def test_a_leg_that_is_where_the_schedule_wants_it_stays(self) -> None:
        standing, swinging = Leg(stance=True), Leg(stance=False)
        assert standing.time_to_switch(wanted=True, force=LOADED) == np.inf
        assert swinging.time_to_switch(wanted=False, force=FREE) == np.inf


class TestEarlyTouchDown:
    def test_a_swinging_leg_that_meets_the_ground_stands_and_is_counted(self) -> None:
        leg = swinging_for(0.15)
        leg.step(wanted=False, force=LOADED)
        assert leg.stance
        assert leg.early_touchdowns == 1

    def test_it_stands_until_the_next_scheduled_takeoff(self) -> None:
        leg = swinging_for(0.15)
        leg.step(wanted=False, force=LOADED)
        assert leg.run(0.3, wanted=False, force=LOADED) == 0
        assert leg.run(0.3, wanted=True, force=LOADED) == 0
        assert leg.stance
        assert leg.step(wanted=False, force=LOADED)

    def test_it_swings_on_if_the_ground_is_lost_again(self) -> None:
        leg = swinging_for(0.15)
        leg.step(wanted=False, force=LOADED)
        leg.run(0.15, wanted=False, force=LOADED)
        assert leg.time_to_switch(wanted=False, force=FREE) == pytest.approx(0.04)
        assert not leg.stance

    def test_in_the_first_half_of_a_swing_it_drags(self) -> None:
        """A horse's feet rise slowly; one that stood again would stay behind for the rest of the swing."""
        leg = swinging_for(0.15)
        leg.step(wanted=False, force=LOADED, swung=0.49)
        assert not leg.stance
        assert leg.early_touchdowns == 0
        leg.step(wanted=False, force=LOADED, swung=0.5)
        assert leg.stance

    def test_a_weak_touch_is_none(self) -> None:
        leg = swinging_for(0.15)
        assert leg.time_to_switch(wanted=False, force=0.099 * WEIGHT) == np.inf


class TestEarlyTakeOff:
    def standing(self) -> Leg:
        leg = Leg(stance=True)
        leg.run(0.2, wanted=True, force=LOADED)
        return leg

    def test_a_leg_that_is_asked_for_little_stands_without_load(self) -> None:
        """Animals shift their weight to some feet before they lift others, which stand meanwhile."""
        leg = Leg(stance=True, asked=0.09 * WEIGHT)
        leg.run(0.2, wanted=True, force=LOADED)
        assert leg.time_to_switch(wanted=True, force=FREE) == np.inf
        leg.memory["roughness"] = 0.03  # m
        assert leg.time_to_switch(wanted=True, force=FREE) == pytest.approx(0.04)

        leg = Leg(stance=True, asked=0.1 * WEIGHT)
        leg.run(0.2, wanted=True, force=LOADED)
        assert leg.time_to_switch(wanted=True, force=FREE) == pytest.approx(0.04)

    def test_a_leg_without_load_for_40_ms_swings(self) -> None:
        leg = self.standing()
        assert leg.time_to_switch(wanted=True, force=FREE) == pytest.approx(0.04)
        assert not leg.stance

    def test_a_leg_that_loses_its_load_for_a_moment_goes_on_standing(self) -> None:
        leg = self.standing()
        for _ in range(5):
            leg.run(0.036, wanted=True, force=FREE)
            leg.step(wanted=True, force=LOADED)
        assert leg.stance

    def test_a_load_between_the_thresholds_is_kept(self) -> None:
        leg = self.standing()
        assert leg.time_to_switch(wanted=True, force=BETWEEN) == np.inf

    def test_it_stands_again_after_100_ms_because_the_schedule_still_wants_it(self) -> None:
        leg = self.standing()
        leg.time_to_switch(wanted=True, force=FREE)
        assert leg.time_to_switch(wanted=True, force=FREE) == pytest.approx(0.1)
        assert leg.stance

    def test_a_leg_that_has_not_met_the_ground_yet_waits_for_it(self) -> None:
        """Touch-down came by the schedule, the ground is a little lower: no load is no reason to swing again."""
        leg = swinging_for(0.2)
        leg.step(wanted=True, force=FREE)
        assert leg.time_to_switch(wanted=True, force=FREE) == np.inf


class TestSwitchingRate:
    """At least 100 ms between two switches of a leg, unless the schedule lifts it off."""

    def test_contact_right_after_lift_off_is_no_touch_down(self) -> None:
        leg = Leg(stance=True)
        leg.step(wanted=False, force=LOADED)
        assert leg.time_to_switch(wanted=False, force=LOADED) == pytest.approx(0.1)

    def test_a_scheduled_takeoff_does_not_wait(self) -> None:
        """A leg that has just stood again would swing late, and too little above the ground."""
        leg = swinging_for(0.2)
        leg.step(wanted=True, force=LOADED)
        assert leg.time_to_switch(wanted=False, force=LOADED) == pytest.approx(DT)

    def test_a_lost_load_waits(self) -> None:
        leg = swinging_for(0.2)
        leg.step(wanted=True, force=FREE)
        leg.step(wanted=True, force=LOADED)
        assert leg.time_to_switch(wanted=True, force=FREE) == pytest.approx(0.1 - DT)

    def test_whatever_happens(self) -> None:
        rng = np.random.default_rng(0)
        leg, last, shortest, switches = Leg(stance=True), -1.0, np.inf, 0
        wanted, force = True, LOADED
        for i in range(20_000):
            if rng.random() < 0.03:
                wanted = not wanted
            if rng.random() < 0.1:
                force = rng.choice([FREE, BETWEEN, LOADED])
            before = leg.stance
            lifted = leg.step(wanted, force)
            assert lifted == (before and not leg.stance), "lift-off is told exactly when it happens"
            if leg.stance != before:
                if wanted or not lifted:
                    shortest = min(shortest, i * DT - last)
                last, switches = i * DT, switches + 1
        assert switches > 100
        assert shortest == pytest.approx(0.1)


class TestScheduleOnly:
    """The planner without contact: the schedule alone counts, at once."""

    SETTINGS = GaitConfig(planner="schedule", contact_threshold=0.1, min_switch_time=0.1)

    @pytest.mark.parametrize("force", [FREE, LOADED])
    def test_the_state_is_the_schedule(self, force: float) -> None:
        leg = Leg(stance=True, settings=self.SETTINGS)
        rng = np.random.default_rng(1)
        for _ in range(200):
            wanted, before = bool(rng.random() < 0.5), leg.stance
            assert leg.step(wanted, force) == (before and not wanted)
            assert leg.stance == wanted
        assert leg.early_touchdowns == 0

    def test_the_time_since_lift_off_is_kept_for_the_blend_of_the_swing(self) -> None:
        leg = Leg(stance=True, settings=self.SETTINGS)
        leg.step(wanted=False, force=FREE)
        assert leg.memory["since_switch"][0, leg.INDEX] == 0.0
        leg.run(0.05, wanted=False, force=FREE)
        assert leg.memory["since_switch"][0, leg.INDEX] == pytest.approx(0.05)


def test_legs_do_not_share_their_memory() -> None:
    leg = Leg(stance=True)
    leg.step(wanted=False, force=LOADED)
    for name in ("stance", "unloaded_time", "missed_time", "was_loaded", "early"):
        others = np.delete(leg.memory[name][0], leg.INDEX)
        np.testing.assert_array_equal(others, 0)
