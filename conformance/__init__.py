"""Conformance suites: numbered cases against any controller, each citing a clause of docs/protocol.md."""
