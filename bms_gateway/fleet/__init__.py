"""Many vehicles: their logs through the engine, a row per vehicle-day and string, and a search for common errors."""
