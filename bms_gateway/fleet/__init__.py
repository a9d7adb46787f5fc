"""Many vehicles: their logs through the one engine, a row per vehicle-day and string, and what they have in common."""
