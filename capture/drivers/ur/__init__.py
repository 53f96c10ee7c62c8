"""Arms of Universal Robots: the driver, the process that holds its client, and what the pendant says."""
