"""The studies of docs/robustness.md: tables and figures from the campaigns ``campaigns/study_*.yaml``."""
