"""The plant against textbook closed forms, published data and two independent engines."""
