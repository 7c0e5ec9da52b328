"""A compiler of IEC 61131-3 structured text: to machine code, and its memory to Python."""
