"""Reads a MATLAB file in a process of its own: SciPy's reader, which is C, crashes on some damaged files.

Run by path, python -P mat_process.py FILE OUT BYTES, so that nothing but NumPy and SciPy is imported. Writes columns
as an npz file, names apart from values; exits with 3 and a reason if the file is damaged, with 4 if it is of version
7.3.
"""

import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import io

DAMAGED, VERSION_7_3 = 3, 4


def columns_of(name: str, value: Any) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Names and columns of a variable."""
    if hasattr(value, "_fieldnames"):
        for field in value._fieldnames:
            yield from columns_of(f"{name}.{field}", getattr(value, field))
    elif not isinstance(value, np.ndarray):
        return
    elif value.dtype == object:
        entries = value.ravel()
        for i, entry in enumerate(entries):
            yield from columns_of(name if len(entries) == 1 else f"{name}{{{i}}}", entry)
    elif value.dtype.kind in "fiub" and value.ndim == 2 and value.size:
        matrix = value.astype(np.float64)
        matrix = matrix if matrix.shape[0] >= matrix.shape[1] else matrix.T
        for j in range(matrix.shape[1]):
            yield (name if matrix.shape[1] == 1 else f"{name}[{j}]"), matrix[:, j].copy()


def main(path: str, out: str, memory: str) -> int:
    """Read and write; see the module."""
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    except (ImportError, ValueError, OSError):
        pass  # where memory cannot be limited
    try:
        content = io.loadmat(path, squeeze_me=False, struct_as_record=False, appendmat=False)
        found = [pair for key, value in content.items() if not key.startswith("__") for pair in columns_of(key, value)]
    except NotImplementedError:
        return VERSION_7_3
    except Exception as error:  # SciPy raises many kinds for a damaged file
        print(error)
        return DAMAGED
    names = np.array([name for name, _ in found], dtype=str)
    arrays: dict[str, Any] = {f"c{i}": column for i, (_, column) in enumerate(found)}
    np.savez(out, names=names, **arrays)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
