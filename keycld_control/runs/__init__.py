"""Trainings to look at: their page, trackers of others, and the list of all."""
