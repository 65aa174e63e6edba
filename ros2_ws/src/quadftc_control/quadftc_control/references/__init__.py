"""References, one file each."""
