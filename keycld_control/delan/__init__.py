"""The character experiment of the papers on Deep Lagrangian Networks, anew."""
