"""Tables in, tables and progress out."""
