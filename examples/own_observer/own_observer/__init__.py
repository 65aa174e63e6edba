"""A fault observer for quadftc in a package of its own."""
