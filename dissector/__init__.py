"""For people who look at the wire: a Wireshark dissector made from the layout tables, and a sniffer."""
