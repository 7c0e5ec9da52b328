"""Targets without markers: a place on the wall, or a drill hole, measured in one stereo pair."""
