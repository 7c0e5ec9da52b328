"""The tables of README.md and the pages of docs that are made of the rows under docs/results."""
