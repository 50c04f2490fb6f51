"""What a page may ask of a live robot, each a JSON object whose ``op`` names it."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from slamsim.guard.errors import SlamsimError, shown
from slamsim.live.controls import Controls, Mode

HOLD_S = 0.25
"""A page that is held repeats its twist each 50 ms: five lost ones stop the robot."""


class RequestRefused(SlamsimError):
    """A message of a page that is no request."""

    exit_code = 2


class Request(BaseModel):
    """Numbers may be anything that JSON can say: ``Controls`` tells which of them it takes."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    op: str

    @abstractmethod
    def carry_out(self, controls: Controls) -> str:
        """What to tell who asked; may take its time. Raises SlamsimError if it cannot be done."""


class DriveRequest(Request):
    op: Literal["drive"]
    speed_m_s: float
    yaw_rate_rad_s: float

    def carry_out(self, controls: Controls) -> str:
        controls.drive(self.speed_m_s, self.yaw_rate_rad_s, HOLD_S)
        return ""


class GoToRequest(Request):
    op: Literal["go_to"]
    x_m: float
    y_m: float
    yaw_rad: float | None = None

    def carry_out(self, controls: Controls) -> str:
        controls.go_to(self.x_m, self.y_m, self.yaw_rad)
        return f"Driving to x {self.x_m:.2f} m, y {self.y_m:.2f} m."


class ModeRequest(Request):
    op: Literal["mode"]
    mode: Mode

    def carry_out(self, controls: Controls) -> str:
        controls.set_mode(self.mode)
        return ""


class PauseRequest(Request):
    op: Literal["pause"]
    paused: bool

    def carry_out(self, controls: Controls) -> str:
        controls.pause(self.paused)
        return ""


class StepRequest(Request):
    op: Literal["step"]
    seconds: float

    def carry_out(self, controls: Controls) -> str:
        controls.step(self.seconds)
        return ""


class RateRequest(Request):
    op: Literal["rate"]
    rate: float | None

    def carry_out(self, controls: Controls) -> str:
        controls.set_rate(self.rate)
        return ""


class ResetRequest(Request):
    op: Literal["reset"]

    def carry_out(self, controls: Controls) -> str:
        controls.reset()
        return "The drive begins anew."


class RecordRequest(Request):
    op: Literal["record"]
    on: bool

    def carry_out(self, controls: Controls) -> str:
        folder = controls.record(self.on)
        if folder is None:
            return "There was no recording to stop."
        return f"{'Recording to' if self.on else 'Recorded in'} {_short(folder)}."


class SaveMapRequest(Request):
    op: Literal["save_map"]

    def carry_out(self, controls: Controls) -> str:
        return f"Map saved in {_short(controls.save_map())}."


AnyRequest = (
    DriveRequest
    | GoToRequest
    | ModeRequest
    | PauseRequest
    | StepRequest
    | RateRequest
    | ResetRequest
    | RecordRequest
    | SaveMapRequest
)
_REQUESTS: TypeAdapter[AnyRequest] = TypeAdapter(Annotated[AnyRequest, Field(discriminator="op")])


def parse_request(text: str | bytes) -> AnyRequest:
    """Raises RequestRefused, which says what is wrong, for what is none."""
    try:
        return _REQUESTS.validate_json(text)
    except ValidationError as error:
        detail = error.errors(include_url=False)[0]
        place = ".".join(map(str, detail["loc"][1:]))
        given = shown(text if detail["type"] == "json_invalid" else detail["input"])
        reason = f"{place}: {detail['msg']}" if place else detail["msg"]
        raise RequestRefused(f"{reason} (given {given})") from None


def _short(folder: Path) -> str:
    """Its last two names: the rest is of no use on another machine."""
    return f"{folder.parent.name}/{folder.name}"
