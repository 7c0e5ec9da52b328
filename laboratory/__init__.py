"""The laboratory: seeded experiments and campaigns, a distribution of its own."""
