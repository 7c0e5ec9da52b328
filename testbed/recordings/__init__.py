"""`longreach recording`: what is in a recording, whether it is whole, and what can be made of it."""
