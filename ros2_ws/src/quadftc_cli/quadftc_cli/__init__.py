"""The quadftc command."""
