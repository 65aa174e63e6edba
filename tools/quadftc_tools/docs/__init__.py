"""What the documents show and a command can make: the map of the packages, the policy."""
