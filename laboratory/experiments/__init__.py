"""Seeded experiments; each writes a table, and its rows as CSV and JSON."""
