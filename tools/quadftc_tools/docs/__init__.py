"""What the documents show and a command can make: the moving picture, the map of the packages."""
