"""What is measured, one file per subject; `keycld bench` prints it all."""
