"""A whole flight log judged at once: what failed, when, how badly, how sure."""
