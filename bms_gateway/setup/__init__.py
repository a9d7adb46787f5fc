"""A new vehicle: from its logs and DBC to a proposal of the role of each signal, and to a config."""
