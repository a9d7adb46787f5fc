"""The package as a library: the steps of the commands as functions on arrays, public as names of `bms_gateway`."""
