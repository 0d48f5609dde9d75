"""How far is searched: more takes longer, and finds better fits or the same; no verdict is measured with these."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Effort:
    """Breadth of the search.

    Attributes:
        windows: that are searched, at most.
        rounds: times that the search starts again from the best set so far.
        sets: sets of one, two and three more effects that are refined a little after each linear scoring.
        finalists: of these, sets that are refined to the end, beside the best of each size.
        pairs: pairs that are scored with every third effect.
        sample_nats: nats of misfit that suffice to choose among sets; where there is more, a share of windows is used.
        sample_windows: windows of that share at least.
        rough: share of what is above noise that a step must gain for another one, while sets are compared.
        rotor_windows: windows that choose among starts of rotors.
        rotor_starts: starts of rotors that are followed further.
        tried_nats: nats that an effect seems to be worth below which the set is fitted without it.
        near_nats: nats behind the best within which sets may be better by held-out recordings, and those of confusable
            effects when they are fitted to their end, or with shorter steps.
        near_sets: sets that are tried so.
        far_behind: share of what pushes explain, where these explain nearly all, below which effects are not exchanged
            for others: one by one, they would have to explain as much again.
    """

    windows: int = 80
    rounds: int = 3
    sets: tuple[int, int, int] = (4, 3, 2)
    finalists: int = 2
    pairs: int = 40
    sample_nats: float = 500.0
    sample_windows: int = 30
    rough: float = 3e-4
    rotor_windows: int = 15
    rotor_starts: int = 6
    tried_nats: float = 100.0
    near_nats: float = 50.0
    near_sets: int = 3
    far_behind: float = 0.5


EFFORT = Effort()
"""That of every diagnosis."""
