"""The coupler's cases: ``table`` says what is written and what must be read, ``steps`` carries it out."""
