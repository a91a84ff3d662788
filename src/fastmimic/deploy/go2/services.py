"""A Go2's services over DDS (JSON on rt/api/SERVICE/request and …/response), and releasing its motion service."""

import json
import time
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from fastmimic.base.errors import DriverError
from fastmimic.deploy.dds.cyclone import LOOPBACK, Participant, TextReader, Writer
from fastmimic.deploy.go2.messages import Request, Response

MOTION_SWITCHER: Final = "motion_switcher"
CHECK_MODE: Final = 1001
SELECT_MODE: Final = 1002
RELEASE_MODE: Final = 1003
SPORT: Final = "sport"
STAND_UP: Final = 1004
STAND_DOWN: Final = 1005

NOT_IMPLEMENTED: Final = 3203  # code of the answer to an unknown request

FIND_S: Final = 1.0  # for a service on this computer to be found
FIND_FAR_S: Final = 5.0  # for one on another
ANSWER_S: Final = 5.0
LIE_DOWN_S: Final = 10.0  # for the robot to lie down
SETTLE_S: Final = 0.5  # from when it looks as if it lay
RELEASE_S: Final = 10.0


class Answer(NamedTuple):
    """An error code, 0 for none, and the result."""

    code: int
    data: dict[str, Any]


class ServiceClient:
    def __init__(self, participant: Participant, service: str) -> None:
        self._service = service
        self._requests = Writer(participant, f"rt/api/{service}/request", Request)
        self._responses = TextReader(participant, f"rt/api/{service}/response", Response)

    def find(self, timeout_s: float = FIND_S) -> bool:
        """Waits for the service; returns whether there is one."""
        end = time.monotonic() + timeout_s
        while self._requests.matched() == 0:
            if time.monotonic() > end:
                return False
            time.sleep(0.02)
        time.sleep(0.2)  # for it to find the reader of its answers
        return True

    def ask(self, api_id: int, parameter: dict[str, Any] | None = None) -> Answer:
        """Sends a request and waits for its answer; raises `DriverError` if none comes."""
        request = self._requests.message
        number = time.monotonic_ns()
        request.header.identity.id, request.header.identity.api_id = number, api_id
        request.parameter = json.dumps(parameter or {}).encode()
        self._responses.take(_heard)  # discards old answers
        self._requests.write()
        end = time.monotonic() + ANSWER_S
        while time.monotonic() < end:
            for identity, answer in self._responses.take(_heard):
                if identity == number:
                    return answer
            time.sleep(0.005)
        raise DriverError(f"the robot's service '{self._service}' does not answer request {api_id}")


class ServiceServer:
    """The simulated robot's side of a service; each handler, by api id, returns its result, None for an empty one."""

    def __init__(self, participant: Participant, service: str, handlers: dict[int, Callable[[], Any]]) -> None:
        self._handlers = handlers
        self._requests = TextReader(participant, f"rt/api/{service}/request", Request)
        self._responses = Writer(participant, f"rt/api/{service}/response", Response)

    def poll(self) -> None:
        """Answers the requests that have arrived."""
        for number, api_id in self._requests.take(_asked):
            handler = self._handlers.get(api_id)
            response = self._responses.message
            response.header.identity.id, response.header.identity.api_id = number, api_id
            response.header.status.code = 0 if handler else NOT_IMPLEMENTED
            response.data = json.dumps((handler() if handler else None) or {}).encode()
            self._responses.write()


def release_motion_service(
    participant: Participant, lies: Callable[[], bool], say: Callable[[str], None] = lambda text: None
) -> str | None:
    """Makes a robot's motion service release the motors, once the robot lies: standing, it would fall. `lies` says
    whether it lies now, `say` takes lines on progress.

    Returns the mode released; None if none was active, or for a simulator on this computer without such a service.
    Raises `DriverError`: a robot without such a service, or one that does not answer, lie down or release the motors.
    """
    switcher = ServiceClient(participant, MOTION_SWITCHER)
    here = participant.interface == LOOPBACK
    if not switcher.find(FIND_S if here else FIND_FAR_S):
        if here:
            return None
        raise DriverError(
            f"no service '{MOTION_SWITCHER}' on '{participant.interface}', so the robot's own software may command the"
            " motors: nothing is sent to them"
        )
    released = mode = _active_mode(switcher)
    if mode is None:
        return None
    if not lies():
        say(f"the robot's motion service '{mode}' is active: it lies down first")
        _lie_down(participant, lies)
    end = time.monotonic() + RELEASE_S
    while mode is not None:
        if time.monotonic() > end:
            raise DriverError(f"the robot's motion service '{mode}' does not release the motors")
        switcher.ask(RELEASE_MODE)
        mode = _active_mode(switcher)
    say(f"the robot's motion service '{released}' was released")
    return released


def _lie_down(participant: Participant, lies: Callable[[], bool]) -> None:
    sport = ServiceClient(participant, SPORT)
    code = sport.ask(STAND_DOWN).code if sport.find() else None
    end = time.monotonic() + LIE_DOWN_S
    while not lies():
        if code is None or time.monotonic() > end:
            why = "it has no sport service" if code is None else f"its service answered with code {code}"
            raise DriverError(
                f"the motors can be released only after the robot lies, but {why} and it still stands: lie it down by"
                " its remote control"
            )
        time.sleep(0.05)
    time.sleep(SETTLE_S)


def _active_mode(switcher: ServiceClient) -> str | None:
    answer = switcher.ask(CHECK_MODE)
    if answer.code != 0:
        raise DriverError(f"the robot does not report whether its motion service is active (code {answer.code})")
    return str(answer.data.get("name") or "") or None


def _heard(response: Any) -> tuple[int, Answer]:
    try:
        data = json.loads((response.data or b"").decode(errors="replace") or "{}")
    except ValueError:
        data = {}
    return response.header.identity.id, Answer(response.header.status.code, data if isinstance(data, dict) else {})


def _asked(request: Any) -> tuple[int, int]:
    return request.header.identity.id, request.header.identity.api_id
