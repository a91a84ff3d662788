"""The real-time loop: reads the robot's state and sends its command at a fixed rate, checked, timed and logged."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

from fastmimic.base.arrays import Records
from fastmimic.base.errors import DriverError
from fastmimic.deploy.computer import LoopClock, Rehearsal, StopSwitch, VirtualClock
from fastmimic.deploy.driver import FIRST_STATE_S, Packets, RobotDriver, damping_command
from fastmimic.deploy.log import Recorder
from fastmimic.deploy.safety import StopReason, Violation
from fastmimic.deploy.state_machine import DeploymentPhase, StateMachine

_AT_ONCE: Final = 2  # signals that end crouching and damping early

Moments = tuple[float, float, float]  # when a state was read, the command ready, and sent; s on the loop's clock


@dataclass(frozen=True)
class LoopOutcome:
    """How a run of the loop ended."""

    stopped_by: StopReason
    text: str  # a line on what was not planned; else empty
    phase: DeploymentPhase
    deadline_misses: int  # periods that sent their command too late
    skipped: int  # periods left out because an earlier one took too long
    packets: Packets  # since the first period


@dataclass(eq=False)
class Loop:
    """One run. Nothing is sent before `run`; afterwards the robot is damped or limp."""

    driver: RobotDriver  # open
    machine: StateMachine  # its guard checks its commands; in a dry run nothing is sent
    recorder: Recorder  # takes a row for each period
    clock: LoopClock  # of the deadlines and of the driver's states
    steps: float  # control steps in the motion after which it ends
    reason: StopReason  # why it ends then
    switch: StopSwitch
    watch: Callable[[StateMachine, Any], None] | None = None
    """Called at the end of each period with the machine and its record of `ROW`."""
    note: Callable[[str], None] = lambda line: None  # takes lines for the operator

    def __post_init__(self) -> None:
        self._guard, self._dt = self.machine.guard, self.machine.dt
        self._damping = damping_command(self._guard.limits.damping)
        self._before, self._late, self._received = Packets(), 0.0, 0.0
        self._misses = self._skipped = 0

    def run(self, on_ready: Callable[[], bool] | None = None) -> LoopOutcome:
        """Runs until the robot lies again; `on_ready` is called when all is prepared, and cancels by returning False.
        Raises `DriverError`, and nothing was sent: cancelled, no state within `FIRST_STATE_S`, or an unfit robot."""
        self._prepare()
        if (on_ready is not None and not on_ready()) or self._emergency() is not None:
            raise DriverError("cancelled; nothing was sent")
        self._begin()
        self._start = self._deadline = self.clock.now() + 2 * self._dt
        self.recorder.start(2 * self._dt)
        try:
            return self._follow()
        except DriverError as error:
            return self._end(Violation(StopReason.DRIVER, str(error)))
        except BaseException:
            if not self._guard.dry:
                self.driver.write(self._damping)
            raise

    def _prepare(self) -> None:
        if not self._read(FIRST_STATE_S):
            if rejected := self.driver.packets.rejected:
                raise DriverError(f"no good state of the robot within {FIRST_STATE_S:g} s: {rejected} were damaged")
            hint = "is it switched on, in low-level mode, and on this network?"
            raise DriverError(f"no state of the robot within {FIRST_STATE_S:g} s: {hint}")
        rehearsal = None if isinstance(self.clock, VirtualClock) else Rehearsal(self.clock, self._dt)
        self.machine.warm_up(self._state.reading, rehearsal)
        if rehearsal is not None:
            self.note(rehearsal.text(self._guard.limits.stale_s))
        self._began = self._start = self._deadline = self.clock.now()
        self._record(True, DeploymentPhase.HOLD, False, self._damping, False, (0.0, 0.0, 0.0))

    def _begin(self) -> None:
        if not self._read(FIRST_STATE_S):
            raise DriverError(f"the robot's states stopped: none for {FIRST_STATE_S:g} s")
        self._before = replace(self.driver.packets)
        self._received = self._state.received
        if (found := self.machine.begin(self._state.reading)) is not None:
            raise DriverError(f"the robot is not fit to begin: {found.text}")

    def _follow(self) -> LoopOutcome:
        machine, ended_by = self.machine, None
        while machine.phase is not DeploymentPhase.DONE:
            self._wait()
            violation = self._emergency() or self._period()
            if violation is not None:
                return self._end(violation)
            if ended_by is None and machine.phase <= DeploymentPhase.FOLLOW:
                if self._foreign():
                    ended_by = StopReason.FOREIGN
                elif self.switch.leave:
                    ended_by = StopReason.ASKED
                elif machine.in_motion and machine.follower.steps >= self.steps:
                    ended_by = self.reason
                if ended_by is not None:
                    machine.leave()
        text = self._foreign() if ended_by is StopReason.FOREIGN else ""
        return self._outcome(ended_by or StopReason.END, text, DeploymentPhase.DONE)

    def _foreign(self) -> str:
        """A line if another program commands the motors and that is not to be ignored."""
        heard = self.driver.packets.foreign - self._before.foreign
        if not heard or self._guard.limits.foreign == "ignore":
            return ""
        return f"another program sends commands to the robot's motors, {heard} until now"

    def _outcome(self, reason: StopReason, text: str, phase: DeploymentPhase) -> LoopOutcome:
        now, before = asdict(self.driver.packets), asdict(self._before)
        packets = Packets(**{name: count - before[name] for name, count in now.items()})
        return LoopOutcome(reason, text, phase, self._misses, self._skipped, packets)

    def _wait(self) -> None:
        """Waits for the next period; skips those already over."""
        self.clock.sleep_until(self._deadline)
        self._began = self.clock.now()
        self._late = self._began - self._deadline
        if self._late >= self._dt:
            missed = int(self._late / self._dt)
            self._skipped += missed
            self._deadline += missed * self._dt

    def _emergency(self) -> Violation | None:
        self.switch.poll()
        if self.switch.key:
            return Violation(StopReason.KEY, "emergency stop by a key")
        if self.switch.signals:
            return Violation(StopReason.SIGNAL, "emergency stop by a signal")
        if self._guard.limits.foreign == "damp" and (text := self._foreign()):
            return Violation(StopReason.FOREIGN, text)
        return None

    def _period(self) -> Violation | None:
        clock, machine = self.clock, self.machine
        for wait_s in (0.0, self._dt):
            fresh = self._read(wait_s)
            read = clock.now()
            violation = self._guard.check_number(StopReason.STALE_STATE, read - self._state.received)
            if violation is None or self._late <= self._dt:
                break  # else this computer paused: a newer state may be about to be delivered
        state = self._state
        phase, command = machine.phase, self._damping
        if violation is None:
            command = machine.step(state.reading, state.received - self._received)
            self._received = state.received
            violation = machine.violation
        ready = clock.now()
        if violation is None:
            late = max(self._late, ready - self._deadline - self._dt)
            violation = self._guard.check_number(StopReason.OVERRUN, late)
        send = violation is None and not self._guard.dry
        if send:
            self.driver.write(command)
        done = clock.now()
        self._record(fresh, phase, machine.in_motion, command, send, (read, ready, done))
        if done > self._deadline + self._dt:
            self._misses += 1
        self._deadline += self._dt
        return violation

    def _read(self, timeout_s: float = 0.0) -> bool:
        """Takes the newest state; returns whether there is a new one."""
        state = self.driver.read(timeout_s)
        if state is not None:
            self._state = state
        return state is not None

    def _record(
        self, fresh: bool, phase: DeploymentPhase, moving: bool, command: Records, sent: bool, times: Moments
    ) -> None:
        """Fills in the row of the period, field by field in the order of `ROW`."""
        machine, state, began, (read, ready, done) = self.machine, self._state, self._began, times
        memory, clock = machine.controller.memory, machine.follower.clock
        packets, before, received = self.driver.packets, self._before, state.received
        spans = began - self._start, self._late, read - began, ready - read, done - ready
        lost = (getattr(packets, name) - getattr(before, name) for name in ("received", "lost", "rejected", "foreign"))
        followed = clock["sample"][0], clock["origin"][0], memory["haste"][0], machine.follower.wanted
        records = state.reading[0], machine.observation[0], command[0]
        control = (memory[name][0] for name in ("force", "solve_time", "early_touchdowns", "qp_failures"))
        flags = self._guard.cut, phase, fresh, moving, sent, memory["stance"][0]
        counts = done - received, read - received, state.sequence, *lost, self._misses, self._skipped
        row = self.recorder.next_row()
        row[0] = *spans, *counts, *followed, *records, *control, *flags
        if self.watch is not None:
            self.watch(machine, row[0])

    def _end(self, violation: Violation) -> LoopOutcome:
        """Crouches, if the reason allows, and damps the joints."""
        phase, limits = self.machine.phase, self._guard.limits
        try:
            if violation.reason.crouches:
                steps = round(limits.crouch_s / self._dt)
                for i in range(steps):
                    self._step_down(DeploymentPhase.CROUCH, self.machine.crouch(i / steps))
                    self.switch.poll()
                    if self.switch.key or self.switch.signals >= _AT_ONCE:
                        break
            for _ in range(max(1, round(limits.damping_s / self._dt))):
                self._step_down(DeploymentPhase.DAMP, self._damping)
                if self.switch.signals >= _AT_ONCE:
                    break
        except DriverError:
            pass  # connection lost; the robot's watchdog damps it
        return self._outcome(violation.reason, violation.text, phase)

    def _step_down(self, phase: DeploymentPhase, command: Records) -> None:
        """One period after the end: a command that needs no state."""
        if not self._guard.dry:
            self.driver.write(command)
        self._began = sent = self.clock.now()
        fresh = self._read()
        times = sent, sent, self.clock.now()
        self._record(fresh, phase, False, command, not self._guard.dry, times)
        self._deadline = max(self._deadline, sent) + self._dt
        self.clock.sleep_until(self._deadline)
