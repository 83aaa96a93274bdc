"""Files that people give and get: read with errors that name line and field, written whole or not at all."""
