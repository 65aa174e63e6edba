"""The study of diagnosis: every fault observer through many flights with random faults.

A `campaign.Study` says how much is flown; `campaign.fly_all` flies what a `store.Store` does not hold yet;
`results.gather` sums up; `publish.publish` writes ``diagnosis.json``, and the tables and figures of
docs/diagnosis.md. From the shell: ``scripts/study_diagnosis``.
"""
