"""What a method needs that is not installed."""

from keycld_envs.errors import InputError


class MissingPackage(InputError):
    """A method cannot be asked anything; its cases are not refused one by one."""
