"""Agents, closed loops and the command line of KeyCLD."""
