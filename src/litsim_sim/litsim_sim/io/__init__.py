"""Reading of user files with errors that name line and field, and atomic writing of files."""
