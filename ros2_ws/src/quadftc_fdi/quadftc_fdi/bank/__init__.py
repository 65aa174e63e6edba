"""One motion model, one table of fault modes, and Bayes for the rest: docs/bank.md."""
