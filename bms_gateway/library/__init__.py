"""The package as a library: the steps of the commands as functions on arrays. `import bms_gateway` gives its names."""
