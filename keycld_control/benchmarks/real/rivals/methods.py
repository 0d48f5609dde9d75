"""Methods by name."""

from keycld_control.benchmarks.named_functions import function_of
from keycld_control.benchmarks.real.rivals.answer import Method

_HERE = "keycld_control.benchmarks.real.rivals"
METHODS = {
    "comparison": f"{_HERE}.comparison:comparison",
    "one set": f"{_HERE}.one_set:one_set",
    "noise": f"{_HERE}.noise:noise",
    "sysid": f"{_HERE}.sysid:sysid",
    "sindy": f"{_HERE}.sindy:sindy",
}
"""Where each is; a place of one's own is "module:function" too."""


def get_method(name: str) -> Method:
    """A method of this package, or one's own as "module:function".

    Raises:
        InputError: if there is none.
    """
    return function_of(name, METHODS)
