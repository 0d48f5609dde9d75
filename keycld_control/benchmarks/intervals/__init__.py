"""How often intervals of world models hold what is true, over mechanisms that are drawn."""
