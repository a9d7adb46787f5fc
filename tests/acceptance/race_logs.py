"""The logs of the race car."""

LOGS = ["uwfe_autocross_2025-04-30_run10", "uwfe_july7_run12", "uwfe_pitt_autocross_02"]
