"""The batch engine, campaigns of thousands of flights, and the tuning of gains."""
