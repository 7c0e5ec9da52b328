"""The laboratory: seeded experiments, campaigns, validation and soak, a distribution of its own."""
