"""The REST API's door, a process of its own that speaks STOP on the reference link."""
