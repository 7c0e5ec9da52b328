"""A seeded proxy between two peers, in user space: loses, delays, reorders and spoils what passes."""
