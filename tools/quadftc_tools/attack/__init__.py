"""Attacks on the software: what strangers, crashes and clocks can do to it, repeated by one command."""
