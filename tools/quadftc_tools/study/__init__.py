"""The studies: tables of docs/, from campaigns and logs."""
