"""Many short rollouts of variants of a simulator."""
