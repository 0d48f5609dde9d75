"""`python -m keycld_control` is the `keycld` command."""

import sys

from keycld_control.cli import main

if __name__ == "__main__":
    sys.exit(main())
