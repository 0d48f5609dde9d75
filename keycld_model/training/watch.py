"""Who looks on while a model is trained."""

from collections.abc import Mapping
from typing import Any, Protocol

from keycld_model.world_model import WorldModel


class Watcher(Protocol):
    """Is told of a training as it goes on; of several processes, by the first."""

    def logged(self, entry: Mapping[str, Any]) -> None:
        """After a line of `log.jsonl`: "step", "stage" or "round", "seconds", and losses or scores."""
        ...

    def saved(self, model: WorldModel | None, *, finished: bool) -> None:
        """After a checkpoint of a world model as it is now, or of a joint model, which is not handed over."""
        ...
