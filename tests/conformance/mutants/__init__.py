"""Controllers and couplers with one thing wrong each, and the cases meant to catch them."""
