"""What tables of the code make: the policy of SROS2."""
