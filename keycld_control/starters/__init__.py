"""Files that `keycld new` copies: declarations of mechanisms to change into one's own, each complete and checked."""
