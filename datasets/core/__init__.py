"""What all commands share: errors, files, schemas, console."""
