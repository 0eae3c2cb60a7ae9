"""The law that a servo uses, and the over-damped gains that may act instead of it."""

from backlash_ros.control.acting import ActingLaw
from backlash_ros.control.law import ControlLaw


class LawInUse:
    """The chosen law with its state; while it is calmed, the over-damped gains act.

    ``name`` is that of the chosen law, also where the settings leave the choice to `AUTO`.
    """

    def __init__(self, name: str, law: ControlLaw) -> None:
        self.name, self.chosen = name, ActingLaw(law)
        self._calming: ActingLaw | None = None

    @property
    def acting(self) -> ActingLaw:
        """What acts without an experiment."""
        return self._calming or self.chosen

    @property
    def calmed(self) -> bool:
        """Whether the over-damped gains act instead of the law."""
        return self._calming is not None

    def calm(self, overdamped: ControlLaw) -> None:
        """Let the over-damped gains act."""
        self._calming = ActingLaw(overdamped)

    def redesign(self, name: str, law: ControlLaw) -> bool:
        """Take another design of the chosen law, which keeps its state; return whether it has to begin again."""
        self.name, begins = name, self.calmed
        self.chosen.redesign(law)
        self._calming = None
        return begins

    def start(self) -> None:
        """Start the chosen law again, with its initial state."""
        self._calming = None
        self.chosen.start()
