"""Rigid bodies with hinges and slides: equations of motion, dry friction and effects, compiled for many copies."""
