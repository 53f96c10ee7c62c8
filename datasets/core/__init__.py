"""Shared by all packages: errors, files, schemas, options, console."""
