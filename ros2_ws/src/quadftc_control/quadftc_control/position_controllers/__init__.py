"""Position controllers, one file each."""
