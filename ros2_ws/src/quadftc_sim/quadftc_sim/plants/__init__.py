"""Plants, one file each."""
