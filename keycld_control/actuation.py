"""What becomes of actions on their way to the joints, where motors are known to be weak, late or stiff.

An agent decides what motors shall do, some frames from now if they are late, and tells them what makes them do it. The
effects themselves say what motors make of a sequence of commands (`AddedEffects.at_motors`); here, that function is
evaluated on the commands of the past, and inverted for the next one.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from keycld_model.added_effects import AddedEffects

Floats = NDArray[np.floating]
ARRIVED = 0.75
"""Share of a command's lasting effect with which it counts as arrived."""
LARGE = 1e3
"""Command in place of an infinite bound."""
HALVINGS = 20
"""Steps of the inversion, each of which halves the interval in which a command lies."""


class Outlook(NamedTuple):
    """What motors will do and can do; all as learned actions are counted.

    Attributes:
        applied: `[m]` what they did in the last frame interval.
        queued: `[D, m]` what they will do in the next ones whatever is decided now, D being the longest lead.
        low: `[m]` what they would do after their lead at the least command.
        high: `[m]` at the greatest.
    """

    applied: Floats
    queued: Floats
    low: Floats
    high: Floats


class Actuation:
    """Commands of the past, and the next one.

    Args:
        added: effects, or None: motors do what they are told.
        low: `[m]` lower bounds of commands.
        high: `[m]` upper bounds.

    Attributes:
        low: `[m]` what motors do for good at the least command.
        high: `[m]` at the greatest.
        lead: `[m]` whole frames after which a command has arrived.
    """

    def __init__(self, added: AddedEffects | None, low: Floats, high: Floats) -> None:
        self._added = added if added is not None and added.changes_commands else None
        self._bounds = low, high
        self.low, self.high, self.lead = low, high, np.zeros(len(low), int)
        self._memory = 1
        if self._added is not None:
            self._memory = 2 + int(np.ceil(self._added.late / self._added.timestep))
            self._least, self._most = np.maximum(low, -LARGE), np.minimum(high, LARGE)
            rising = self._made_of(self._held(self._most, np.zeros((1, len(low))), 2 * self._memory))[1:]
            self.high, self.low = rising[-1], self._made_of(self._held(self._least, self._least[None], 2))[-1]
            self.lead = (rising >= ARRIVED * rising[-1]).argmax(axis=0)
        self.reset()

    def reset(self) -> None:
        """Forget the past, in which no command was given."""
        self._past = np.zeros((self._memory, len(self.low)))

    def outlook(self) -> Outlook:
        """Before the next command."""
        if self._added is None:
            return Outlook(self._past[-1], self._past[:0], *self._bounds)
        now, steps = self._memory, int(self.lead.max())
        going_on = self._made_of(self._held(self._past[-1], self._past, steps))
        return Outlook(going_on[now - 1], going_on[now:], self._arriving(self._least), self._arriving(self._most))

    def command(self, wanted: Floats) -> Floats:
        """The command `[m]` with which motors, after their lead, do what is wanted `[m]`, or what is nearest to it."""
        command = np.asarray(wanted)
        if self._added is not None:
            command = np.where(command == 0, 0.0, self._inverse(command))
        self._past = np.concatenate([self._past[1:], command[None]])
        return command

    def _inverse(self, wanted: Floats) -> Floats:
        """By regula falsi with halving: motors do more the more they are told."""
        low, high = self._least.copy(), self._most.copy()
        at_low, at_high = self._arriving(low), self._arriving(high)
        for step in range(HALVINGS):
            share = np.clip((wanted - at_low) / np.maximum(at_high - at_low, 1e-12), 0.0, 1.0)
            tried = low + (high - low) * (share if step == 0 else 0.5)
            got = self._arriving(tried)
            if step == 0 and np.allclose(got, np.clip(wanted, at_low, at_high), atol=1e-6 * np.max(self._most)):
                return tried
            more = got < wanted
            low, at_low = np.where(more, tried, low), np.where(more, got, at_low)
            high, at_high = np.where(more, high, tried), np.where(more, at_high, got)
        return 0.5 * (low + high)

    def _arriving(self, command: Floats) -> Floats:
        """What motors do `[m]` after their lead, if they are told `[m]` from now on."""
        made = self._made_of(self._held(command, self._past, int(self.lead.max()) + 1))
        return made[self._memory + self.lead, np.arange(len(self.lead))]

    def _made_of(self, commands: Floats) -> Floats:
        assert self._added is not None
        return self._added.at_motors(commands)

    @staticmethod
    def _held(command: Floats, past: Floats, steps: int) -> Floats:
        return np.concatenate([past, np.repeat(command[None], steps, axis=0)])
