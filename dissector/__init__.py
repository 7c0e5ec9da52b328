"""A dissector of the reference link for Wireshark and tshark: ``longreach.lua``, written by hand."""

from pathlib import Path

SCRIPT = Path(__file__).with_name("longreach.lua")
