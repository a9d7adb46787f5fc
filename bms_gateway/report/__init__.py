"""Results as text, JSON, CSV and HTML; tables of measurements; progress bars."""
