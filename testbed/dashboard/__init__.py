"""The dashboard of the services' figures: its table, and a trial with a real Prometheus."""
