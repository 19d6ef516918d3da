"""The request for stages that is on its way, as a value: what is shown, what is dropped, when the window is idle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

_INTERRUPT_DELAY_S = 0.5  # a younger request finishes, so that a drag shows intermediate results


@dataclass(frozen=True, slots=True, kw_only=True)
class Requests:
    """State of the requests for stages; every change returns another value. Tickets are those of `LatestJob`."""

    # running: stages are computed. draft: the same, for a dragged parameter, whose stage is not on screen yet. stale:
    # the stages were dropped for a short job and must be requested again.
    state: Literal["idle", "running", "draft", "stale"] = "idle"
    ticket: int = 0  # newest request, or short job in place of one; 0 = none
    oldest_shown: int = 0  # parts of older tickets are of another recording
    opening: int = 0  # ticket that opens a recording; 0 = none
    background: int = 0  # newest job of lowest priority
    draft_stage: str = ""  # whose draft is computed
    started_s: float = 0.0  # when a request last cancelled the one before

    @property
    def is_running(self) -> bool:
        """Whether stages are computed."""
        return self.state in ("running", "draft")

    def must_interrupt(self, now_s: float, *, opens: bool) -> bool:
        """Return whether a new request cancels the running one; a draft, or a young request, finishes first."""
        is_young = self.is_running and now_s - self.started_s < _INTERRUPT_DELAY_S
        return opens or not (self.state == "draft" or is_young)

    def request(self, ticket: int, now_s: float, *, opens: bool, interrupts: bool, draft_stage: str = "") -> Requests:
        """Request stages; `opens` another recording or sensors, whose parts alone are shown from now on."""
        return replace(
            self, state="draft" if draft_stage else "running", draft_stage=draft_stage, ticket=ticket,
            oldest_shown=ticket if opens else self.oldest_shown, opening=ticket if opens or self.opening else 0,
            started_s=now_s if interrupts else self.started_s,
        )  # fmt: skip

    def yield_to(self, ticket: int, *, background: bool) -> Requests:
        """Let a short job take the place of the stages, which are stale then if they were on their way."""
        state = "idle" if self.state == "idle" else "stale"
        return replace(self.end(), state=state, ticket=ticket, background=ticket if background else self.background)

    def show_part(self, stage: str = "") -> Requests:
        """Show a part: the recording is open, and the draft of its stage is on screen."""
        is_awaited = self.state == "draft" and stage == self.draft_stage
        return replace(self, opening=0, state="running" if is_awaited else self.state)

    def end(self) -> Requests:
        """End the request: finished, failed or cancelled."""
        return replace(self, state="idle", opening=0)

    def close_recording(self, newest_ticket: int) -> Requests:
        """Show nothing more of any request up to `newest_ticket`."""
        return replace(self.end(), ticket=0, background=0, oldest_shown=newest_ticket + 1)

    def accepts(self, ticket: int) -> bool:
        """Return whether results of this ticket are still shown."""
        return ticket >= self.oldest_shown
