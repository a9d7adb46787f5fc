"""Model compared with measurement: where it fails, and which physical effect is missing. No files, no clock."""
