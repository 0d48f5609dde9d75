"""`python -m keycld_control.cli` is the `keycld` command."""

from keycld_control.cli import console

if __name__ == "__main__":
    console()
