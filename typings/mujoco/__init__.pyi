# MuJoCo's classes are compiled and ship no stubs: their attributes are unknown to the type checker.
from typing import Any

def __getattr__(name: str) -> Any: ...
