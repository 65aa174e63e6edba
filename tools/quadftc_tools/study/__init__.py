"""The studies of docs/diagnosis.md and docs/robustness.md: tables and figures, from campaigns and logs."""
