"""What square markers may look like and still be read, beside other readers."""
